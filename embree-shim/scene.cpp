// Device and scene of Embree: copies the arrays into buffers that Embree owns, attaches every part, commits.
#include "scene.hpp"

#include <algorithm>
#include <cstring>
#include <memory>

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
    // RTC_ERROR_UNKNOWN, and what a later version adds: Embree 4.4 has an error of GPUs.
    default: return "unknown error";
  }
}

RTCBuildQuality quality_of(std::uint32_t quality) noexcept {
  switch (quality) {
    case SHIM_QUALITY_LOW: return RTC_BUILD_QUALITY_LOW;
    case SHIM_QUALITY_HIGH: return RTC_BUILD_QUALITY_HIGH;
    default: return RTC_BUILD_QUALITY_MEDIUM;
  }
}

Bounds bounds_of(const RTCBounds& bounds) noexcept {
  return {{bounds.lower_x, bounds.lower_y, bounds.lower_z}, {bounds.upper_x, bounds.upper_y, bounds.upper_z}};
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
    : device_(settings.device),
      quality_(quality_of(settings.quality)),
      flags_(settings.flags),
      commit_(settings.commit),
      vertex_count_(vertex_count) {
  // Embree refits in scenes of low quality only; the first tree of such a geometry is one of medium quality.
  if (commit_ == SHIM_COMMIT_REFIT) quality_ = RTC_BUILD_QUALITY_LOW;
  scene_ = rtcNewScene(device_.get());
  device_.check("cannot create a scene");
  // A destructor does not run for an object whose constructor throws, so the scene is held here until it is complete.
  std::unique_ptr<RTCSceneTy, decltype(&rtcReleaseScene)> scene(scene_, &rtcReleaseScene);

  set_flags();
  // Embree reads vertices 16 bytes at a time, so the last one needs 4 bytes behind it; 16 are given.
  constexpr std::size_t padding = 16;
  const std::size_t bytes = vertex_count * 3 * sizeof(float);
  std::unique_ptr<RTCBufferTy, Release> buffer(rtcNewBuffer(device_.get(), bytes + padding));
  device_.check("cannot allocate the vertices");
  // The geometries hold the buffer; without one, there is nobody to read it.
  vertices_ = static_cast<float*>(rtcGetBufferData(buffer.get()));
  if (bytes != 0) std::memcpy(vertices_, vertices, bytes);
  std::memset(vertices_ + 3 * vertex_count, 0, padding);

  attached_.parts.reserve(part_count);
  for (std::uint32_t id = 0; id < part_count; id++) attach(id, parts[id], buffer.get(), vertex_count);
  rtcCommitScene(scene_);
  device_.check("cannot commit the scene");
  describe();
  scene.release();
}

// What was planted is freed behind the scene.
Scene::~Scene() { rtcReleaseScene(scene_); }

void Scene::set_flags() {
  rtcSetSceneBuildQuality(scene_, quality_);
  int flags = RTC_SCENE_FLAG_NONE;
  if (flags_ & SHIM_SCENE_ROBUST) flags |= RTC_SCENE_FLAG_ROBUST;
  if (flags_ & SHIM_SCENE_COMPACT) flags |= RTC_SCENE_FLAG_COMPACT;
  if (commit_ != SHIM_COMMIT_ONCE) flags |= RTC_SCENE_FLAG_DYNAMIC;
  rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(flags));
}

void Scene::update(const float* vertices, std::uint64_t vertex_count) {
  if (commit_ == SHIM_COMMIT_ONCE) throw Error(RTC_ERROR_INVALID_OPERATION, "the scene is committed only once");
  if (vertex_count != vertex_count_) {
    throw Error(RTC_ERROR_INVALID_ARGUMENT, "the scene has " + std::to_string(vertex_count_) + " vertices, and " +
                                                std::to_string(vertex_count) + " are given");
  }
  bool attached = false;
  for (std::uint32_t id = 0; id < parts().size(); id++) {
    const Part& part = parts()[id];
    if (part.faces == 0) continue;
    attached = true;
    RTCGeometry geometry = rtcGetGeometry(scene_, id);
    rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
    // A refit knows nothing of faces that were dropped and can be kept now, or the reverse: then the faces count as new.
    if (part.keeps_otherwise(reinterpret_cast<const unsigned char*>(vertices))) {
      rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0);
    }
    rtcCommitGeometry(geometry);
    device_.check("cannot update a geometry");
  }
  // Nothing has read the vertices so far. Without a geometry that holds it there is no buffer.
  if (attached) std::memcpy(vertices_, vertices, vertex_count * 3 * sizeof(float));
  // Embree finds its own tree, whatever it does to it.
  choose(0);
  planted_.clear();
  rtcCommitScene(scene_);
  device_.check("cannot commit the scene again");
  describe();
}

void Scene::attach(std::uint32_t id, const ShimPart& part, RTCBuffer vertices, std::uint64_t vertex_count) {
  const bool quads = part.corners == 4;
  Part here;
  here.faces = part.faces;
  here.corners = quads ? 4 : 3;
  here.mask = part.mask;
  here.first_triangle = part.first_triangle;
  here.vertex_count = vertex_count;
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
    // Both buffers are Embree's, which the geometry keeps alive.
    here.vertices = static_cast<const unsigned char*>(rtcGetBufferData(vertices));
    here.indices = static_cast<const unsigned char*>(indices);
    here.index_stride = face_bytes;
    rtcSetGeometryMask(handle, part.mask);
    rtcSetGeometryBuildQuality(handle, commit_ == SHIM_COMMIT_REFIT ? RTC_BUILD_QUALITY_REFIT : quality_);
    rtcCommitGeometry(handle);
    rtcAttachGeometryByID(scene_, handle, id);
    device_.check("cannot attach a geometry");
  }
  attached_.triangle_count += part.faces * here.triangles_per_face();
  attached_.parts.push_back(here);
}

// What Embree says of the committed scene, for those who read its tree.
void Scene::describe() {
  attached_.device = device_.get();
  attached_.scene = scene_;
  attached_.version = static_cast<std::uint32_t>(rtcGetDeviceProperty(device_.get(), RTC_DEVICE_PROPERTY_VERSION));
  RTCLinearBounds linear;
  rtcGetSceneLinearBounds(scene_, &linear);
  attached_.bounds[0] = bounds_of(linear.bounds0);
  attached_.bounds[1] = bounds_of(linear.bounds1);
  attached_.spatial_splits = quality_ == RTC_BUILD_QUALITY_HIGH;
}

ShimPlanted Scene::plant(const ShimTreeFile& file, const ShimFault* fault) {
  Ground ground;
  ground.device = attached_.device;
  ground.scene = attached_.scene;
  ground.version = attached_.version;
  std::copy(attached_.bounds, attached_.bounds + 2, ground.bounds);
  ground.spatial_splits = attached_.spatial_splits;
  ground.others = attached_.others;
  ground.vertices = [](const void* scene, std::uint32_t geometry) {
    auto* handle = static_cast<RTCScene>(const_cast<void*>(scene));
    const void* data = rtcGetGeometryBufferData(rtcGetGeometry(handle, geometry), RTC_BUFFER_TYPE_VERTEX, 0);
    return data;
  };
  // The checks are of Embree's own tree.
  const std::uint32_t before = chosen_;
  choose(0);
  try {
    planted_.reserve(planted_.size() + 1);
    planted_.push_back(shim::plant(ground, file, fault));
  } catch (...) {
    choose(before);
    throw;
  }
  chosen_ = static_cast<std::uint32_t>(planted_.size());
  ShimPlanted planted = planted_.back()->describe();
  planted.number = chosen_;
  return planted;
}

bool Scene::choose(std::uint32_t number) noexcept {
  if (number > planted_.size()) return false;
  if (number != 0) {
    planted_[number - 1]->make_current();
  } else if (chosen_ != 0) {
    planted_[chosen_ - 1]->restore();
  }
  chosen_ = number;
  return true;
}

Tree Scene::live_tree(const ShimFault* fault) const {
  if (chosen_ == 0) return read_live_tree(attached_, fault);
  const PlantedTree& planted = *planted_[chosen_ - 1];
  Attached scene = attached_;
  scene.spatial_splits = scene.spatial_splits || planted.splits();
  const bool slots = fault != nullptr && fault->slots != 0;
  return read_live_scene(scene, fault, nullptr, slots ? nullptr : &planted).tree;
}

std::uint64_t Scene::triangles(float* triangles) const noexcept {
  std::uint64_t replaced = 0;
  for (const Part& part : parts()) {
    float* out = triangles + std::size_t{9} * part.first_triangle;
    for (std::uint64_t face = 0; face < part.faces; face++, out += 9 * part.triangles_per_face()) {
      replaced += part.triangles(face, out);
    }
  }
  return replaced;
}

}  // namespace shim
