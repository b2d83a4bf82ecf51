// Reading memory whose layout is only believed: every address is looked up in the process's maps before it is touched.
#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "shim.h"

namespace shim {

// A check of the live tree that failed; the message says which. The caller falls back to rtcBuildBVH.
class Doubt : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// What a read is for: names it in a Doubt, and lets tests corrupt it.
enum class Object : std::uint32_t {
  scene = SHIM_OBJECT_SCENE,
  accel_list = SHIM_OBJECT_ACCEL_LIST,
  accel = SHIM_OBJECT_ACCEL,
  bvh = SHIM_OBJECT_BVH,
  vtable = SHIM_OBJECT_VTABLE,
  code = SHIM_OBJECT_CODE,
  text = SHIM_OBJECT_TEXT,
  node = SHIM_OBJECT_NODE,
  leaf = SHIM_OBJECT_LEAF,
  vertex = SHIM_OBJECT_VERTEX,
};

// Addresses from `begin` up to, without, `end`.
struct Range {
  std::uintptr_t begin;
  std::uintptr_t end;
};

// Whether all of [address, address + bytes) lies in one of the sorted ranges.
bool covers(const std::vector<Range>& ranges, std::uintptr_t address, std::size_t bytes) noexcept;

// Access to memory that may turn out not to be what it is taken for.
class Memory {
 public:
  virtual ~Memory() = default;
  // Copies `bytes` from `address`; throws Doubt when they are not all readable memory of this process.
  virtual void read(Object object, std::uintptr_t address, void* out, std::size_t bytes) = 0;
};

// This process's memory, as mapped when the object was made.
class ProcessMemory final : public Memory {
 public:
  ProcessMemory();
  void read(Object object, std::uintptr_t address, void* out, std::size_t bytes) override;

 private:
  std::vector<Range> readable_;
  std::size_t last_ = 0;
};

// Another memory with one fault: what tests see the checks through.
class FaultyMemory final : public Memory {
 public:
  FaultyMemory(Memory& inner, const ShimFault& fault) : inner_(inner), fault_(fault) {}
  void read(Object object, std::uintptr_t address, void* out, std::size_t bytes) override;

 private:
  Memory& inner_;
  const ShimFault& fault_;
  std::uint64_t reads_ = 0;
};

// Where the loaded libembree3 lies; all empty when there is none.
struct Image {
  std::vector<Range> segments;
  std::vector<Range> code;
};

Image find_image();

}  // namespace shim
