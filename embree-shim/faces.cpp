// Faces as TRIS has them, and what is less often asked of boxes and parts.
#include "faces.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace shim {

bool Bounds::operator==(const Bounds& other) const noexcept {
  return std::equal(lower, lower + 3, other.lower) && std::equal(upper, upper + 3, other.upper);
}

bool Part::keeps_otherwise(const unsigned char* others) const noexcept {
  Part other = *this;
  other.vertices = others;
  for (std::uint64_t face = 0; face < faces; face++) {
    if (keeps(face) != other.keeps(face)) return true;
  }
  return false;
}

std::uint32_t Part::triangles(std::uint64_t face, float* triangles) const noexcept {
  const bool kept = keeps(face);
  std::uint32_t replaced = 0;
  float* out = triangles;
  for (std::uint32_t half = 0; half < triangles_per_face(); half++, out += 9) {
    const auto chosen = corners_of(half);
    bool finite = true;
    for (int corner = 0; corner < 3; corner++) {
      constexpr float nan = std::numeric_limits<float>::quiet_NaN();
      const bool there = index(face, chosen[corner]) < vertex_count;
      const auto position = there ? vertex(face, chosen[corner]) : std::array<float, 3>{nan, nan, nan};
      for (int axis = 0; axis < 3; axis++) {
        out[3 * corner + axis] = position[axis];
        finite = finite && std::isfinite(position[axis]);
      }
    }
    if (finite && !kept) {
      std::fill(out, out + 9, std::numeric_limits<float>::quiet_NaN());
      replaced++;
    }
  }
  return replaced;
}

}  // namespace shim
