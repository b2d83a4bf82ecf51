// Device and scene of Embree, owned.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "embree_api.hpp"
#include "error.hpp"
#include "faces.hpp"
#include "plant.hpp"
#include "shim.h"

namespace shim {

// An RTCDevice, and the last message that it reported.
class Device {
 public:
  explicit Device(const char* config);
  ~Device();
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  RTCDevice get() const noexcept { return device_; }
  // Throws what Embree has reported on this thread since the last call, with `action` before it.
  void check(const char* action) const;

 private:
  static void remember(void* user, RTCError code, const char* message) noexcept;

  RTCDevice device_ = nullptr;
  mutable std::string message_;
};

// A committed scene. Part i is attached as geomID i; parts without faces are numbered but not attached. All parts share one
// buffer of vertices.
class Scene {
 public:
  Scene(const ShimSettings& settings, const float* vertices, std::uint64_t vertex_count, const ShimPart* parts,
        std::uint32_t part_count);
  ~Scene();
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  // Other vertices for the same faces, as many as before: copies them and commits. Needs settings that let a scene be
  // committed again.
  void update(const float* vertices, std::uint64_t vertex_count);

  RTCScene get() const noexcept { return scene_; }
  const Device& device() const noexcept { return device_; }
  RTCBuildQuality quality() const noexcept { return quality_; }
  std::uint32_t flags() const noexcept { return flags_; }
  const std::vector<Part>& parts() const noexcept { return attached_.parts; }
  std::uint64_t triangle_count() const noexcept { return attached_.triangle_count; }
  const Attached& attached() const noexcept { return attached_; }
  // Plants a tree, and makes it the current one; see shim_scene_plant. Throws Doubt.
  ShimPlanted plant(const ShimTreeFile& file, const ShimFault* fault);
  // Makes another one current; see shim_scene_choose. False when there is none of that number.
  bool choose(std::uint32_t number) noexcept;
  // The tree that queries traverse, read from memory. Throws Doubt.
  Tree live_tree(const ShimFault* fault) const;
  // Writes the elements of TRIS: 9 floats each. See shim_scene_triangles for what is replaced and returned.
  std::uint64_t triangles(float* triangles) const noexcept;

 private:
  void attach(std::uint32_t id, const ShimPart& part, RTCBuffer vertices, std::uint64_t vertex_count);
  void set_flags();
  void describe();

  Device device_;
  RTCScene scene_ = nullptr;
  RTCBuildQuality quality_ = RTC_BUILD_QUALITY_MEDIUM;
  std::uint32_t flags_ = 0;
  std::uint32_t commit_ = SHIM_COMMIT_ONCE;
  float* vertices_ = nullptr;  // Embree's buffer
  std::uint64_t vertex_count_ = 0;
  Attached attached_;
  std::vector<std::unique_ptr<PlantedTree>> planted_;  // since the last commit
  std::uint32_t chosen_ = 0;                           // as in shim_scene_choose
};

}  // namespace shim
