// What a committed scene has attached: the numbering of triangles that every other part of the shim shares, and where
// Embree finds their vertices. Nothing in here calls Embree.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "ray_check.hpp"

namespace shim {

struct Bounds {
  float lower[3];
  float upper[3];

  // The identity of `extend`; also the box of an empty tree.
  static Bounds empty() noexcept {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    return {{infinity, infinity, infinity}, {-infinity, -infinity, -infinity}};
  }

  void extend(const Bounds& other) noexcept {
    for (int axis = 0; axis < 3; axis++) {
      lower[axis] = std::min(lower[axis], other.lower[axis]);
      upper[axis] = std::max(upper[axis], other.upper[axis]);
    }
  }

  bool contains(const Bounds& other) const noexcept {
    bool inside = true;
    for (int axis = 0; axis < 3; axis++) {
      inside = inside && lower[axis] <= other.lower[axis] && other.upper[axis] <= upper[axis];
    }
    return inside;
  }

  bool overlaps(const Bounds& other) const noexcept {
    bool overlap = true;
    for (int axis = 0; axis < 3; axis++) {
      overlap = overlap && lower[axis] <= other.upper[axis] && other.lower[axis] <= upper[axis];
    }
    return overlap;
  }

  // Whether lower <= upper on every axis, and none is NaN.
  bool is_proper() const noexcept {
    return lower[0] <= upper[0] && lower[1] <= upper[1] && lower[2] <= upper[2];
  }

  bool operator==(const Bounds& other) const noexcept;
};

// Where one geometry's faces are: in the arrays that Embree reads, and in TRIS. Without faces and no instance, nothing is
// attached under its number, or nothing that has triangles.
struct Part {
  const unsigned char* vertices = nullptr;
  std::size_t vertex_stride = 3 * sizeof(float);
  std::uint64_t vertex_count = 0;
  const unsigned char* indices = nullptr;  // null when there is no face, or they are implied
  std::size_t index_stride = 0;  // 0: implied, the corners of each face being vertices of its own
  std::uint64_t faces = 0;
  std::uint32_t corners = 3;
  std::uint32_t mask = 0;
  std::uint32_t first_triangle = 0;
  bool instance = false;  // of a scene of its own, whose triangles are numbered from first_triangle

  std::uint32_t triangles_per_face() const noexcept { return corners - 2; }

  // Which corners make the face's only, first or second triangle: (v0, v1, v2), or (v0, v1, v3) and (v2, v3, v1).
  std::array<std::uint32_t, 3> corners_of(std::uint32_t half) const noexcept {
    if (corners == 3) return {0, 1, 2};
    return half == 0 ? std::array<std::uint32_t, 3>{0, 1, 3} : std::array<std::uint32_t, 3>{2, 3, 1};
  }

  std::uint32_t index(std::uint64_t face, std::uint32_t corner) const noexcept {
    if (index_stride == 0) return static_cast<std::uint32_t>(corners * face + corner);
    std::uint32_t index;
    std::memcpy(&index, indices + face * index_stride + corner * sizeof index, sizeof index);
    return index;
  }

  // x, y and z.
  std::array<float, 3> vertex(std::uint64_t face, std::uint32_t corner) const noexcept {
    std::array<float, 3> position;
    std::memcpy(position.data(), vertices + std::size_t{index(face, corner)} * vertex_stride, sizeof position);
    return position;
  }

  // Whether Embree keeps the face: it drops one with a vertex that is missing, NaN or too large.
  bool keeps(std::uint64_t face) const noexcept {
    for (std::uint32_t corner = 0; corner < corners; corner++) {
      if (index(face, corner) >= vertex_count) return false;
      for (const float coordinate : vertex(face, corner)) {
        if (!(std::fabs(coordinate) < embree_large)) return false;
      }
    }
    return true;
  }
  // Whether Embree would keep other faces with these vertices in place of its own, as many and as far apart.
  bool keeps_otherwise(const unsigned char* others) const noexcept;
  // The box of one of a face's triangles.
  Bounds bounds(std::uint64_t face, std::uint32_t half) const noexcept {
    Bounds bounds = Bounds::empty();
    for (const std::uint32_t corner : corners_of(half)) {
      const auto position = vertex(face, corner);
      for (int axis = 0; axis < 3; axis++) {
        bounds.lower[axis] = std::min(bounds.lower[axis], position[axis]);
        bounds.upper[axis] = std::max(bounds.upper[axis], position[axis]);
      }
    }
    return bounds;
  }
  // Writes the face's triangles, 9 floats each. What Embree drops gets NaN in all nine when it would be finite otherwise;
  // returns how many finite triangles were replaced so.
  std::uint32_t triangles(std::uint64_t face, float* triangles) const noexcept;
};

// A committed scene, as those see it who read its tree.
struct Attached {
  const void* device = nullptr;
  const void* scene = nullptr;
  std::uint32_t version = 0;     // RTC_DEVICE_PROPERTY_VERSION
  Bounds bounds[2];              // rtcGetSceneLinearBounds
  bool spatial_splits = false;   // whether its quality lets Embree split triangles
  bool others = false;           // whether there are geometries that are none of these, or move
  std::vector<Part> parts;       // by geomID
  std::uint64_t triangle_count = 0;  // elements of TRIS
};

}  // namespace shim
