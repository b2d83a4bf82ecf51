// Records what a program asks one of its scenes, by whatever call of Embree's it likes: rays and
// answers -> ShimRecord -> batches
// -> the sink.
//
// While a scene is recorded, the functions in its table of kernels are ours, and ask Embree's. A
// thread fills a batch of its own without a lock; it is passed on when it is full, and at the end.
// The program's filters are wrapped meanwhile, so that what they refuse is recorded, too.
#pragma once

#include <cstdint>
#include <memory>

#include "host_faces.hpp"
#include "host_scene.hpp"

namespace shim {

class HostRecording {
 public:
  // From now on what is asked is recorded. Nobody may be asking the scene. Throws Doubt when its
  // kernels are not where they are expected, or as many scenes are recorded as can be.
  HostRecording(const HostScene& scene, const HostNumbering& numbering, const ShimHostSink& sink);
  // Ends it. Nobody may be asking the scene.
  ~HostRecording();
  HostRecording(const HostRecording&) = delete;
  HostRecording& operator=(const HostRecording&) = delete;

  // Ends it, passes on what is left, and says what was not recorded.
  ShimHostEnd end() noexcept;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

// What the calling thread asks from now on is of this pixel, depth and purpose (docs/formats.md).
void label(std::uint32_t path, std::uint8_t depth, std::uint8_t purpose) noexcept;

}  // namespace shim
