// Which rays Embree must never see: Debian's libembree3 has its asserts compiled in, and each of these aborts the process.
#pragma once

#include <cmath>
#include <limits>

#include "shim.h"

namespace shim {

// Embree's FLT_LARGE (common/math/constants.h): the largest magnitude of a ray's coordinates that its asserts let pass.
// A vertex has to be smaller, or its primitive is dropped.
constexpr float embree_large = 1.844E18f;

// Whether Embree answers the ray instead of aborting. A comparison with NaN is false, so NaN never passes.
// tfar < tnear, tfar = -inf and a zero direction pass: Embree answers them with a miss. `&`, not `&&`: no branches.
inline bool is_answerable(const ShimQuery& query) noexcept {
  const auto within = [](float value) { return std::fabs(value) <= embree_large; };
  constexpr float infinity = std::numeric_limits<float>::infinity();
  return within(query.origin[0]) & within(query.origin[1]) & within(query.origin[2]) & within(query.direction[0]) &
         within(query.direction[1]) & within(query.direction[2]) & (query.tnear >= 0.0f) & (query.tnear <= infinity) &
         (std::fabs(query.tfar) <= infinity);
}

}  // namespace shim
