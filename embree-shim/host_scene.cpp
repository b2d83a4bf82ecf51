// Handles of the program -> scenes; what is planted in them.
#include "host_scene.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

namespace shim {
namespace {

// In type_info: the name of the class that a scene is of.
constexpr const char* scene_class = "N6embree5SceneE";

template <typename T>
T read(Memory& memory, Object object, std::uintptr_t address) {
  T value;
  memory.read(object, address, &value, sizeof value);
  return value;
}

// Of an object with virtual functions, whose first word leads to them; before them stands its
// type_info, and in that, behind a pointer, the class's name.
bool is_scene(Memory& memory, const Image& image, std::uintptr_t address) {
  const auto vtable = read<std::uint64_t>(memory, Object::scene, address);
  if (!covers(image.segments, vtable - 8, 16)) return false;
  const auto type = read<std::uint64_t>(memory, Object::vtable, vtable - 8);
  if (!covers(image.segments, type, 16)) return false;
  const auto name = read<std::uint64_t>(memory, Object::vtable, type + 8);
  const std::size_t length = std::strlen(scene_class) + 1;
  if (!covers(image.segments, name, length)) return false;
  for (std::size_t at = 0; at < length; at++) {
    if (read<char>(memory, Object::text, name + at) != scene_class[at]) return false;
  }
  return true;
}

RTCScene checked(const void* handle) {
  if (handle == nullptr) throw Doubt("the scene is null");
  const Image image = find_image();
  if (image.segments.empty()) throw Doubt("the image of libembree3 is not found in this process");
  ProcessMemory memory;
  const auto address = reinterpret_cast<std::uintptr_t>(handle);
  bool found = false;
  try {
    found = address % alignof(void*) == 0 && is_scene(memory, image, address);
  } catch (const Doubt&) {
    // It leads out of memory.
  }
  if (!found) throw Doubt("what was given as a scene is none of this process's libembree3");
  // Embree takes scenes that it does not change as others.
  return static_cast<RTCScene>(const_cast<void*>(handle));
}

Bounds bounds_of(const RTCBounds& bounds) noexcept {
  return {{bounds.lower_x, bounds.lower_y, bounds.lower_z},
          {bounds.upper_x, bounds.upper_y, bounds.upper_z}};
}

const void* vertices_of(const void* scene, std::uint32_t geometry) {
  RTCGeometry found = rtcGetGeometry(static_cast<RTCScene>(const_cast<void*>(scene)), geometry);
  return found == nullptr ? nullptr : rtcGetGeometryBufferData(found, RTC_BUFFER_TYPE_VERTEX, 0);
}

}  // namespace

HostScene::HostScene(const void* handle) : scene_(checked(handle)) { rtcRetainScene(scene_); }

HostScene::~HostScene() { rtcReleaseScene(scene_); }

Ground HostScene::known() const {
  Ground ground;
  RTCDevice device = rtcGetSceneDevice(scene_);
  ground.device = device;
  ground.scene = scene_;
  ground.version =
      static_cast<std::uint32_t>(rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION));
  rtcReleaseDevice(device);
  ground.vertices = &vertices_of;
  return ground;
}

Ground HostScene::ground() const {
  Ground ground = known();
  // Embree leaves them as they are where the scene is not committed.
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  RTCLinearBounds linear;
  linear.bounds0.lower_x = nan;
  rtcGetSceneLinearBounds(scene_, &linear);
  if (std::isnan(linear.bounds0.lower_x))
    throw Doubt("the scene has not been committed since it was made or changed");
  ground.bounds[0] = bounds_of(linear.bounds0);
  ground.bounds[1] = bounds_of(linear.bounds1);
  return ground;
}

Ground HostScene::last_ground() const {
  Ground ground = known();
  ProcessMemory memory;
  const auto accel =
      read<layout::Accel>(memory, Object::scene, reinterpret_cast<std::uintptr_t>(scene_));
  for (int time = 0; time < 2; time++) {
    std::copy(accel.bounds[time][0], accel.bounds[time][0] + 3, ground.bounds[time].lower);
    std::copy(accel.bounds[time][1], accel.bounds[time][1] + 3, ground.bounds[time].upper);
  }
  return ground;
}

HostPlanting::~HostPlanting() {
  try {
    restore();
  } catch (...) {
    // Embree may still refer to it.
    static_cast<void>(planted_.release());
  }
}

ShimPlanted HostPlanting::plant(const ShimTreeFile& file) {
  const Ground ground = scene_.ground();
  const bool stood = planted_ != nullptr && planted_->is_current(ground);
  // The checks are of Embree's own tree.
  if (planted_ != nullptr) planted_->give_back(ground);
  try {
    auto planted = shim::plant(ground, file, nullptr);
    planted_ = std::move(planted);
  } catch (...) {
    if (stood) planted_->make_current();
    throw;
  }
  return planted_->describe();
}

bool HostPlanting::restore() {
  if (planted_ == nullptr) return false;
  // Most often before the commit of a change.
  planted_->give_back(scene_.last_ground());
  planted_.reset();
  return true;
}

const PlantedTree* HostPlanting::current() const {
  if (planted_ == nullptr || !planted_->is_current(scene_.ground())) return nullptr;
  return planted_.get();
}

}  // namespace shim
