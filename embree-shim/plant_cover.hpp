// Whether the boxes of the leaves that a triangle was split among leave no hole in it.
#pragma once

#include <cstdint>
#include <vector>

#include "plant_file.hpp"

namespace shim {

// A triangle that sticks out of the box of a leaf in which it stands.
struct ClippedTriangle {
  std::uint32_t triangle;
  Bounds box;
};

// Throws Doubt unless the boxes of each triangle that is named cover it, up to the rounding of a
// corner that was computed by cutting: a few units in the last place of the largest coordinate.
void check_covered(std::vector<ClippedTriangle> parts, const FileFaces& faces);

}  // namespace shim
