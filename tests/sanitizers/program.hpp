// A program that has nothing but Embree's API, its scenes, what a .bvh of one holds, and trees that are none of Embree's: for
// planting.cpp and host.cpp.
#pragma once

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "check.hpp"
#include "plant.hpp"

namespace program {

using namespace shim;

using checks::Random;

// What a .bvh holds.
struct File {
  std::vector<ShimNode> nodes;
  std::vector<std::uint32_t> primitives;
  std::vector<float> triangles;
  std::vector<ShimGeometry> geometries;
  std::uint32_t flags = 0;

  ShimTreeFile view() const {
    return {nodes.data(),     nodes.size(),     primitives.data(), primitives.size(), triangles.data(),
            triangles.size() / 9, geometries.data(), geometries.size(), nullptr,       flags};
  }
};

// A triangle, or the part of it within a box.
struct Reference {
  std::uint32_t triangle;
  Bounds box;
};

// Builds trees that are none of Embree's: cut in the middle of the longest axis, triangles sorted
// to a side by their centre, or, with splits, standing on both sides of it.
class Builder {
 public:
  Builder(File& file, std::uint32_t width, bool splits) : file_(file), width_(width), splits_(splits) {}

  void build() {
    std::vector<Reference> all;
    for (std::uint32_t triangle = 0; triangle < file_.triangles.size() / 9; triangle++) {
      const float* at = file_.triangles.data() + 9 * triangle;
      Bounds box = Bounds::empty();
      for (int corner = 0; corner < 3; corner++) {
        Bounds point;
        std::copy(at + 3 * corner, at + 3 * corner + 3, point.lower);
        std::copy(at + 3 * corner, at + 3 * corner + 3, point.upper);
        box.extend(point);
      }
      all.push_back({triangle, box});
    }
    file_.flags = splits_ ? SHIM_FILE_SPLITS : 0;
    file_.primitives.clear();
    file_.nodes.assign(1, ShimNode{});
    fill(0, std::move(all), 0);
  }

 private:
  static Bounds around(const std::vector<Reference>& references) {
    Bounds bounds = Bounds::empty();
    for (const Reference& reference : references) bounds.extend(reference.box);
    return bounds;
  }

  // Two parts; the second is empty when there is nothing to divide.
  std::vector<Reference> divide(std::vector<Reference>& references) const {
    const Bounds bounds = around(references);
    int axis = 0;
    for (int other = 1; other < 3; other++) {
      if (bounds.upper[other] - bounds.lower[other] > bounds.upper[axis] - bounds.lower[axis]) axis = other;
    }
    const float middle = bounds.lower[axis] + 0.5f * (bounds.upper[axis] - bounds.lower[axis]);
    std::vector<Reference> below, above;
    for (const Reference& reference : references) {
      const float lower = reference.box.lower[axis];
      const float upper = reference.box.upper[axis];
      if (splits_ && lower < middle && upper > middle) {
        below.push_back(reference);
        below.back().box.upper[axis] = middle;
        above.push_back(reference);
        above.back().box.lower[axis] = middle;
      } else {
        (0.5f * (lower + upper) < middle ? below : above).push_back(reference);
      }
    }
    if (below.empty() || above.empty() || below.size() + above.size() > 3 * references.size() / 2) {
      const auto half = references.begin() + static_cast<std::ptrdiff_t>(references.size() / 2);
      below.assign(references.begin(), half);
      above.assign(half, references.end());
    }
    references = std::move(below);
    return above;
  }

  void fill(std::uint32_t node, std::vector<Reference> references, int depth) {
    const Bounds bounds = around(references);
    std::copy(bounds.lower, bounds.lower + 3, file_.nodes[node].lower);
    std::copy(bounds.upper, bounds.upper + 3, file_.nodes[node].upper);
    if (references.size() <= 6 || depth == 40) {
      file_.nodes[node].first = static_cast<std::uint32_t>(file_.primitives.size());
      file_.nodes[node].count = leaf_bit | static_cast<std::uint32_t>(references.size());
      for (const Reference& reference : references) file_.primitives.push_back(reference.triangle);
      return;
    }
    std::vector<std::vector<Reference>> parts;
    parts.push_back(std::move(references));
    while (parts.size() < width_) {
      const auto largest = std::max_element(parts.begin(), parts.end(), [](const auto& a, const auto& b) {
        return a.size() < b.size();
      });
      if (largest->size() < 2) break;
      std::vector<Reference> other = divide(*largest);
      parts.push_back(std::move(other));
    }
    const auto first = static_cast<std::uint32_t>(file_.nodes.size());
    file_.nodes[node].first = first;
    file_.nodes[node].count = static_cast<std::uint32_t>(parts.size());
    file_.nodes.resize(file_.nodes.size() + parts.size());
    for (std::uint32_t part = 0; part < parts.size(); part++) {
      fill(first + part, std::move(parts[part]), depth + 1);
    }
  }

  File& file_;
  std::uint32_t width_;
  bool splits_;
};

inline void box_of_user_geometry(const RTCBoundsFunctionArguments* arguments) {
  *arguments->bounds_o = {5, 5, 5, 0, 6, 6, 6, 0};
}

// Refuses a third of all candidates.
inline void refuse(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (RTCHitN_primID(arguments->hit, arguments->N, lane) % 3 == 0) arguments->valid[lane] = 0;
  }
}

// A scene of triangles and quads with numbers, strides and masks of its own, and what a .bvh of it
// has.
class Program {
 public:
  Program(const char* config, int flags, std::uint32_t faces, std::uint64_t seed)
      : device_(rtcNewDevice(config)), random_(seed) {
    if (device_ == nullptr) return;
    scene_ = rtcNewScene(device_);
    const int all = flags | RTC_SCENE_FLAG_DYNAMIC | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION;
    rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(all));
    add(RTC_GEOMETRY_TYPE_TRIANGLE, 3, faces);
    add(RTC_GEOMETRY_TYPE_QUAD, 7, faces / 2);
    add(RTC_GEOMETRY_TYPE_TRIANGLE, 4, faces / 3);
    rtcCommitScene(scene_);
    for (int ray = 0; ray < 600; ray++) rays_.push_back(any_ray());
  }
  ~Program() { release(); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  bool is_there() const { return device_ != nullptr; }
  RTCScene scene() const { return scene_; }
  RTCDevice device() const { return device_; }
  const std::vector<RTCGeometry>& geometries() const { return geometries_; }
  const File& file() const { return file_; }
  const std::vector<RTCRayHit>& rays() const { return rays_; }

  void release() {
    for (RTCGeometry geometry : geometries_) rtcReleaseGeometry(geometry);
    geometries_.clear();
    if (scene_ != nullptr) rtcReleaseScene(scene_);
    if (device_ != nullptr) rtcReleaseDevice(device_);
    scene_ = nullptr;
    device_ = nullptr;
  }

  void change() {
    for (RTCGeometry geometry : geometries_) {
      rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
      rtcCommitGeometry(geometry);
    }
  }

  // The scene as its API tells of it.
  Ground ground() const {
    Ground ground;
    ground.device = device_;
    ground.scene = scene_;
    ground.version =
        static_cast<std::uint32_t>(rtcGetDeviceProperty(device_, RTC_DEVICE_PROPERTY_VERSION));
    RTCLinearBounds linear;
    rtcGetSceneLinearBounds(scene_, &linear);
    const auto bounds = [](const RTCBounds& from) {
      return Bounds{{from.lower_x, from.lower_y, from.lower_z}, {from.upper_x, from.upper_y, from.upper_z}};
    };
    ground.bounds[0] = bounds(linear.bounds0);
    ground.bounds[1] = bounds(linear.bounds1);
    ground.vertices = [](const void* scene, std::uint32_t geometry) -> const void* {
      auto* handle = static_cast<RTCScene>(const_cast<void*>(scene));
      return rtcGetGeometryBufferData(rtcGetGeometry(handle, geometry), RTC_BUFFER_TYPE_VERTEX, 0);
    };
    return ground;
  }

  // Distances, -1 for a miss; of every second ray with a filter. What is occluded is what is hit.
  std::vector<float> answers() const {
    std::vector<float> found;
    for (std::size_t index = 0; index < rays_.size(); index++) {
      RTCIntersectContext context;
      rtcInitIntersectContext(&context);
      if (index % 2 == 0) context.filter = refuse;
      RTCRayHit asked = rays_[index];
      rtcIntersect1(scene_, &context, &asked);
      const bool hit = asked.hit.geomID != RTC_INVALID_GEOMETRY_ID;
      RTCRay shadow = rays_[index].ray;
      rtcOccluded1(scene_, &context, &shadow);
      CHECK((shadow.tfar < 0) == hit);
      found.push_back(hit ? asked.ray.tfar : -1);
    }
    return found;
  }

 private:
  RTCRayHit any_ray() {
    RTCRayHit ray{};
    ray.ray.org_x = 2 * random_.signed_unit();
    ray.ray.org_y = 2 * random_.signed_unit();
    ray.ray.org_z = 2 * random_.signed_unit();
    ray.ray.dir_x = random_.signed_unit() - ray.ray.org_x;
    ray.ray.dir_y = random_.signed_unit() - ray.ray.org_y;
    ray.ray.dir_z = random_.signed_unit() - ray.ray.org_z;
    ray.ray.tfar = std::numeric_limits<float>::infinity();
    ray.ray.mask = 1 + random_.below(7);
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    return ray;
  }

  void add(RTCGeometryType type, unsigned id, std::uint32_t faces) {
    const bool quads = type == RTC_GEOMETRY_TYPE_QUAD;
    const std::size_t corners = quads ? 4 : 3;
    RTCGeometry geometry = rtcNewGeometry(device_, type);
    const std::size_t stride = 12 + 4 * (id % 3);
    auto* vertices = static_cast<char*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, stride, corners * faces));
    auto* indices = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                                quads ? RTC_FORMAT_UINT4 : RTC_FORMAT_UINT3, 4 * corners, faces));
    ShimGeometry row{0xFFFFFFFFu, id, static_cast<std::uint32_t>(file_.triangles.size() / 9),
                     static_cast<std::uint32_t>((corners - 2) * faces), 1u << (id % 3), quads ? 1u : 0u, 0, 0};
    for (std::uint32_t face = 0; face < faces; face++) {
      float points[4][3];
      for (int axis = 0; axis < 3; axis++) {
        points[0][axis] = random_.signed_unit();
        points[1][axis] = points[0][axis] + 0.3f * random_.signed_unit();
        points[2][axis] = points[1][axis] + 0.3f * random_.signed_unit();
        points[3][axis] = points[0][axis] + 0.3f * random_.signed_unit();
      }
      for (std::size_t corner = 0; corner < corners; corner++) {
        const std::size_t vertex = corners * face + corner;
        std::memcpy(vertices + stride * vertex, points[corner], sizeof points[corner]);
        indices[vertex] = static_cast<std::uint32_t>(vertex);
      }
      const auto push = [&](int a, int b, int c) {
        for (const int corner : {a, b, c}) {
          file_.triangles.insert(file_.triangles.end(), points[corner], points[corner] + 3);
        }
      };
      if (quads) {
        push(0, 1, 3);
        push(2, 3, 1);
      } else {
        push(0, 1, 2);
      }
    }
    rtcSetGeometryMask(geometry, row.mask);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene_, geometry, id);
    geometries_.push_back(geometry);
    file_.geometries.push_back(row);
  }

  RTCDevice device_;
  RTCScene scene_ = nullptr;
  Random random_;
  std::vector<RTCGeometry> geometries_;
  File file_;
  std::vector<RTCRayHit> rays_;
};

inline bool same(const std::vector<float>& a, const std::vector<float>& b) {
  const auto near = [](float x, float y) { return (x < 0) == (y < 0) && std::fabs(x - y) <= 1e-4f * std::fabs(x); };
  return std::equal(a.begin(), a.end(), b.begin(), near);
}

}  // namespace program
