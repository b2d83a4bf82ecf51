// Device and scene of Embree: copies the arrays into buffers that Embree owns, attaches every part, commits.
#include "scene.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>

#include "ray_check.hpp"

namespace shim {
namespace {

const char* name(RTCError code) noexcept {
  switch (code) {
    case RTC_ERROR_NONE: return "no error";
    case RTC_ERROR_INVALID_ARGUMENT: return "invalid argument";
    case RTC_ERROR_INVALID_OPERATION: return "invalid operation";
    case RTC_ERROR_OUT_OF_MEMORY: return "out of memory";
    case RTC_ERROR_UNSUPPORTED_CPU: return "not supported by this CPU";
    case RTC_ERROR_CANCELLED: return "cancelled";
    case RTC_ERROR_UNKNOWN: break;
  }
  return "unknown error";
}

RTCBuildQuality quality_of(std::uint32_t quality) noexcept {
  switch (quality) {
    case SHIM_QUALITY_LOW: return RTC_BUILD_QUALITY_LOW;
    case SHIM_QUALITY_HIGH: return RTC_BUILD_QUALITY_HIGH;
    default: return RTC_BUILD_QUALITY_MEDIUM;
  }
}

// Releases Embree's buffers and geometries when their scope ends; the scene holds references of its own.
struct Release {
  void operator()(RTCBuffer buffer) const noexcept { rtcReleaseBuffer(buffer); }
  void operator()(RTCGeometry geometry) const noexcept { rtcReleaseGeometry(geometry); }
};

}  // namespace

Device::Device(const char* config) : device_(rtcNewDevice(config)) {
  if (device_ == nullptr) {
    const RTCError code = rtcGetDeviceError(nullptr);
    throw Error(code, std::string("cannot create an Embree device (") + config + "): " + name(code));
  }
  rtcSetDeviceErrorFunction(device_, &Device::remember, this);
}

Device::~Device() { rtcReleaseDevice(device_); }

// Embree calls this on the thread that called it, in the middle of the call that fails.
void Device::remember(void* user, RTCError, const char* message) noexcept {
  try {
    static_cast<Device*>(user)->message_ = message == nullptr ? "" : message;
  } catch (...) {
    // No memory for the message: the code alone has to do.
  }
}

void Device::check(const char* action) const {
  const RTCError code = rtcGetDeviceError(device_);
  if (code == RTC_ERROR_NONE) return;
  std::string message = std::string(action) + ": " + name(code);
  if (!message_.empty()) message += " (" + message_ + ")";
  throw Error(code, message);
}

Scene::Scene(const ShimSettings& settings, const float* vertices, std::uint64_t vertex_count, const ShimPart* parts,
             std::uint32_t part_count)
    : device_(settings.device), quality_(quality_of(settings.quality)), flags_(settings.flags) {
  scene_ = rtcNewScene(device_.get());
  device_.check("cannot create a scene");
  // A destructor does not run for an object whose constructor throws, so the scene is held here until it is complete.
  std::unique_ptr<RTCSceneTy, decltype(&rtcReleaseScene)> scene(scene_, &rtcReleaseScene);

  rtcSetSceneBuildQuality(scene_, quality_);
  int flags = RTC_SCENE_FLAG_NONE;
  if (flags_ & SHIM_SCENE_ROBUST) flags |= RTC_SCENE_FLAG_ROBUST;
  if (flags_ & SHIM_SCENE_COMPACT) flags |= RTC_SCENE_FLAG_COMPACT;
  rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(flags));

  // Embree reads vertices 16 bytes at a time, so the last one needs 4 bytes behind it; 16 are given.
  constexpr std::size_t padding = 16;
  const std::size_t bytes = vertex_count * 3 * sizeof(float);
  std::unique_ptr<RTCBufferTy, Release> buffer(rtcNewBuffer(device_.get(), bytes + padding));
  device_.check("cannot allocate the vertices");
  char* data = static_cast<char*>(rtcGetBufferData(buffer.get()));
  if (bytes != 0) std::memcpy(data, vertices, bytes);
  std::memset(data + bytes, 0, padding);
  vertices_ = reinterpret_cast<const float*>(data);

  parts_.reserve(part_count);
  for (std::uint32_t id = 0; id < part_count; id++) attach(id, parts[id], buffer.get(), vertex_count);
  rtcCommitScene(scene_);
  device_.check("cannot commit the scene");
  // Without a geometry nothing holds the buffer, and nothing reads it either.
  if (triangle_count_ == 0) vertices_ = nullptr;
  scene.release();
}

Scene::~Scene() { rtcReleaseScene(scene_); }

void Scene::attach(std::uint32_t id, const ShimPart& part, RTCBuffer vertices, std::uint64_t vertex_count) {
  const bool quads = part.corners == 4;
  Part here;
  here.faces = part.faces;
  here.corners = quads ? 4 : 3;
  here.mask = part.mask;
  here.first_triangle = static_cast<std::uint32_t>(triangle_count_);
  if (part.faces != 0) {
    std::unique_ptr<RTCGeometryTy, Release> geometry(
        rtcNewGeometry(device_.get(), quads ? RTC_GEOMETRY_TYPE_QUAD : RTC_GEOMETRY_TYPE_TRIANGLE));
    device_.check("cannot create a geometry");
    RTCGeometry handle = geometry.get();
    rtcSetGeometryBuffer(handle, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, vertices, 0, 3 * sizeof(float),
                         vertex_count);
    device_.check("cannot set the vertices of a geometry");
    const std::size_t face_bytes = here.corners * sizeof(std::uint32_t);
    void* indices = rtcSetNewGeometryBuffer(handle, RTC_BUFFER_TYPE_INDEX, 0, quads ? RTC_FORMAT_UINT4 : RTC_FORMAT_UINT3,
                                            face_bytes, part.faces);
    device_.check("cannot allocate the faces of a geometry");
    std::memcpy(indices, part.indices, face_bytes * part.faces);
    here.indices = static_cast<const std::uint32_t*>(indices);
    rtcSetGeometryMask(handle, part.mask);
    rtcSetGeometryBuildQuality(handle, quality_);
    rtcCommitGeometry(handle);
    rtcAttachGeometryByID(scene_, handle, id);
    device_.check("cannot attach a geometry");
  }
  triangle_count_ += part.faces * here.triangles_per_face();
  parts_.push_back(here);
}

bool Scene::keeps(const Part& part, std::uint64_t face) const noexcept {
  for (std::uint32_t corner = 0; corner < part.corners; corner++) {
    const float* position = vertex(part.indices[face * part.corners + corner]);
    for (int axis = 0; axis < 3; axis++) {
      if (!(std::fabs(position[axis]) < embree_large)) return false;
    }
  }
  return true;
}

std::uint64_t Scene::triangles(float* triangles) const noexcept {
  std::uint64_t replaced = 0;
  float* out = triangles;
  for (const Part& part : parts_) {
    for (std::uint64_t face = 0; face < part.faces; face++) {
      const bool kept = keeps(part, face);
      for (std::uint32_t half = 0; half < part.triangles_per_face(); half++, out += 9) {
        const auto chosen = part.corners_of(half);
        bool finite = true;
        for (int corner = 0; corner < 3; corner++) {
          const float* position = vertex(part.indices[face * part.corners + chosen[corner]]);
          for (int axis = 0; axis < 3; axis++) {
            out[3 * corner + axis] = position[axis];
            finite = finite && std::isfinite(position[axis]);
          }
        }
        if (finite && !kept) {
          std::fill(out, out + 9, std::numeric_limits<float>::quiet_NaN());
          replaced++;
        }
      }
    }
  }
  return replaced;
}

}  // namespace shim
