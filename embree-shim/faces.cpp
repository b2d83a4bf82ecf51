// Faces: their vertices, which of them Embree keeps, and boxes.
#include "faces.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "ray_check.hpp"

namespace shim {

Bounds Bounds::empty() noexcept {
  constexpr float infinity = std::numeric_limits<float>::infinity();
  return {{infinity, infinity, infinity}, {-infinity, -infinity, -infinity}};
}

void Bounds::extend(const Bounds& other) noexcept {
  for (int axis = 0; axis < 3; axis++) {
    lower[axis] = std::min(lower[axis], other.lower[axis]);
    upper[axis] = std::max(upper[axis], other.upper[axis]);
  }
}

bool Bounds::contains(const Bounds& other) const noexcept {
  bool inside = true;
  for (int axis = 0; axis < 3; axis++) {
    inside = inside && lower[axis] <= other.lower[axis] && other.upper[axis] <= upper[axis];
  }
  return inside;
}

bool Bounds::overlaps(const Bounds& other) const noexcept {
  bool overlap = true;
  for (int axis = 0; axis < 3; axis++) {
    overlap = overlap && lower[axis] <= other.upper[axis] && other.lower[axis] <= upper[axis];
  }
  return overlap;
}

bool Bounds::is_proper() const noexcept {
  return lower[0] <= upper[0] && lower[1] <= upper[1] && lower[2] <= upper[2];
}

bool Bounds::operator==(const Bounds& other) const noexcept {
  return std::equal(lower, lower + 3, other.lower) && std::equal(upper, upper + 3, other.upper);
}

bool Part::keeps(std::uint64_t face) const noexcept {
  for (std::uint32_t corner = 0; corner < corners; corner++) {
    if (index(face, corner) >= vertex_count) return false;
    for (const float coordinate : vertex(face, corner)) {
      if (!(std::fabs(coordinate) < embree_large)) return false;
    }
  }
  return true;
}

bool Part::keeps_otherwise(const unsigned char* others) const noexcept {
  Part other = *this;
  other.vertices = others;
  for (std::uint64_t face = 0; face < faces; face++) {
    if (keeps(face) != other.keeps(face)) return true;
  }
  return false;
}

Bounds Part::bounds(std::uint64_t face, std::uint32_t half) const noexcept {
  Bounds bounds = Bounds::empty();
  for (const std::uint32_t corner : corners_of(half)) {
    const auto position = vertex(face, corner);
    for (int axis = 0; axis < 3; axis++) {
      bounds.lower[axis] = std::min(bounds.lower[axis], position[axis]);
      bounds.upper[axis] = std::max(bounds.upper[axis], position[axis]);
    }
  }
  return bounds;
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
