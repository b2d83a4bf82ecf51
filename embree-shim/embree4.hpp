// What Embree 4 calls by the same names as Embree 3, with other arguments. Debian 12 has no header of it, so what the preload
// library needs stands here: https://github.com/RenderKit/embree, doc/src/api.md, "Upgrading from Embree 3 to Embree 4".
//
// The same in both, and so taken from embree3.hpp: rays, hits, packets, bounds, filter functions and their arguments,
// the numbers of formats, buffers and geometry types, and every call that is not declared here. (A hit of Embree 4 may have a
// field behind the last one of Embree 3.)
#pragma once

#include <cstddef>
#include <cstdint>

#include "embree3.hpp"

namespace embree4 {

// RTCIntersectArguments and RTCOccludedArguments: optional, and both start like this.
struct Arguments {
  std::uint32_t flags;
  std::uint32_t feature_mask;
  void* context;
  RTCFilterFunctionN filter;
};
static_assert(sizeof(Arguments) == 24 && offsetof(Arguments, filter) == 16);

// RTC_RAY_QUERY_FLAG_COHERENT.
constexpr std::uint32_t coherent = 1u << 16;

// The mask of a geometry that the program gives none; Embree 3 sets all bits.
constexpr std::uint32_t default_mask = 1;

using Single = void (*)(RTCScene scene, void* ray, Arguments* arguments);
using Packet = void (*)(const int* valid, RTCScene scene, void* rays, Arguments* arguments);
using SharedBuffer = void (*)(RTCGeometry geometry, RTCBufferType type, unsigned slot, RTCFormat format, const void* data,
                              const void* device_data, std::size_t offset, std::size_t stride, std::size_t count);
using NewBuffer = void (*)(RTCGeometry geometry, RTCBufferType type, unsigned slot, RTCFormat format, std::size_t stride,
                           std::size_t count, void** data, void** device_data);

}  // namespace embree4
