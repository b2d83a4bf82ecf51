// Device and scene of Embree, owned; and the numbering of triangles that every other part of the shim shares.
#pragma once

#include <embree3/rtcore.h>

#include <array>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "shim.h"

namespace shim {

// Something that Embree refused; never crosses the C ABI (see shim.cpp).
class Error : public std::runtime_error {
 public:
  Error(RTCError code, const std::string& message) : std::runtime_error(message), code_(code) {}
  RTCError code() const noexcept { return code_; }

 private:
  RTCError code_;
};

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

// Where the faces of one geometry are, in Embree's memory and in TRIS.
struct Part {
  const std::uint32_t* indices = nullptr;  // null when there is no face
  std::uint64_t faces = 0;
  std::uint32_t corners = 3;
  std::uint32_t mask = 0;
  std::uint32_t first_triangle = 0;

  std::uint32_t triangles_per_face() const noexcept { return corners - 2; }
  // Which corners make the face's only, first or second triangle: (v0, v1, v2), or (v0, v1, v3) and (v2, v3, v1).
  std::array<std::uint32_t, 3> corners_of(std::uint32_t half) const noexcept {
    if (corners == 3) return {0, 1, 2};
    return half == 0 ? std::array<std::uint32_t, 3>{0, 1, 3} : std::array<std::uint32_t, 3>{2, 3, 1};
  }
};

// A committed scene. Part i is attached as geomID i; parts without faces are numbered but not attached.
class Scene {
 public:
  Scene(const ShimSettings& settings, const float* vertices, std::uint64_t vertex_count, const ShimPart* parts,
        std::uint32_t part_count);
  ~Scene();
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  RTCScene get() const noexcept { return scene_; }
  const Device& device() const noexcept { return device_; }
  RTCBuildQuality quality() const noexcept { return quality_; }
  std::uint32_t flags() const noexcept { return flags_; }
  const std::vector<Part>& parts() const noexcept { return parts_; }
  std::uint64_t triangle_count() const noexcept { return triangle_count_; }
  // x, y and z of a vertex.
  const float* vertex(std::uint32_t index) const noexcept { return vertices_ + std::size_t{3} * index; }
  // Whether Embree keeps the face: it drops one with a vertex that is NaN or too large.
  bool keeps(const Part& part, std::uint64_t face) const noexcept;
  // Writes the elements of TRIS: 9 floats each. See shim_scene_triangles for what is replaced and returned.
  std::uint64_t triangles(float* triangles) const noexcept;

 private:
  void attach(std::uint32_t id, const ShimPart& part, RTCBuffer vertices, std::uint64_t vertex_count);

  Device device_;
  RTCScene scene_ = nullptr;
  RTCBuildQuality quality_ = RTC_BUILD_QUALITY_MEDIUM;
  std::uint32_t flags_ = 0;
  const float* vertices_ = nullptr;  // Embree's buffer, which the geometries share and keep alive
  std::vector<Part> parts_;
  std::uint64_t triangle_count_ = 0;
};

}  // namespace shim
