// The constants of a record (docs/formats.md), for those who fill one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "shim.h"

namespace shim {

constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr std::uint32_t no_triangle = 0xFFFFFFFFu;
constexpr std::uint32_t no_path = 0xFFFFFFFFu;
constexpr std::uint8_t no_depth = 0xFF;
constexpr std::uint8_t kind_closest_hit = 0;
constexpr std::uint8_t kind_occlusion = 1;
constexpr std::uint8_t flag_hit = 1;
constexpr std::uint8_t flag_coherent = 2;
constexpr std::uint8_t flag_has_rejects = 4;
constexpr std::uint8_t flag_undecided = 8;
constexpr std::uint8_t flag_interrupted = 16;
constexpr std::uint8_t purpose_unknown = 0;

static_assert(sizeof(ShimRecord) == 64);
static_assert(offsetof(ShimRecord, t) == 40 && offsetof(ShimRecord, path) == 56 && offsetof(ShimRecord, purpose) == 63);

}  // namespace shim
