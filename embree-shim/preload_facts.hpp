// What Embree itself says of a committed scene: what the reader of its tree and the planter both go by.
#pragma once

#include <cstdint>

#include "preload_library.hpp"
#include "tree.hpp"

namespace preload {

inline shim::Bounds bounds_of(const RTCBounds& bounds) noexcept {
  return {{bounds.lower_x, bounds.lower_y, bounds.lower_z}, {bounds.upper_x, bounds.upper_y, bounds.upper_z}};
}

// Fills what a reader (shim::Attached) and a planter (shim::Ground) of a committed scene ask of Embree itself.
template <typename Facts>
void ask_embree(RTCScene scene, Facts& facts) noexcept {
  RTCDevice device = real().rtcGetSceneDevice(scene);
  facts.device = device;
  facts.scene = scene;
  facts.version = static_cast<std::uint32_t>(real().rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION));
  real().rtcReleaseDevice(device);
  RTCLinearBounds linear;
  real().rtcGetSceneLinearBounds(scene, &linear);
  facts.bounds[0] = bounds_of(linear.bounds0);
  facts.bounds[1] = bounds_of(linear.bounds1);
}

}  // namespace preload
