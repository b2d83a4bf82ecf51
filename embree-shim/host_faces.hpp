// What a committed scene of the program's holds, found without its help: the live trees say which
// geometries there are, and Embree's objects where their vertices and faces lie.
//
// Embree tells where a geometry's buffers begin, and neither how many elements they have nor how
// far apart those are, nor the mask. Where its objects keep that is found by experiment, on a
// geometry of our own; and nothing is taken for true that the tree does not bear out: the vertices
// of every lane of every block are those of the face that it names, bit by bit, and no face is
// without a lane.
#pragma once

#include <cstdint>
#include <vector>

#include "asking.hpp"
#include "host_scene.hpp"
#include "tree.hpp"

namespace shim {

// Where hits are in TRIS.
class HostNumbering {
 public:
  explicit HostNumbering(const std::vector<Part>& parts);

  // As record needs it; the scene has no instances of its own, and nothing that moves.
  asking::Found triangle(std::uint32_t instance, std::uint32_t geometry, std::uint32_t primitive,
                         float u, float v) const noexcept;
  bool is_undecided() const noexcept { return false; }

  // The geometries that have triangles.
  std::vector<std::uint32_t> geometries() const;

 private:
  struct Place {
    std::uint32_t first_triangle = 0;
    std::uint32_t faces = 0;
    bool quads = false;
  };
  std::vector<Place> places_;
};

// A scene as a .bvh has it.
struct HostCapture {
  Tree tree;
  std::vector<float> triangles;  // 9 floats each
  std::vector<ShimGeometry> geometries;
  HostNumbering numbering;
  std::uint32_t version;
};

// Throws Doubt when the scene is not committed, holds anything but triangles and quads that stand
// still, or is not as expected. `planted` is what stands in it; null when that is Embree's own.
HostCapture capture(const HostScene& scene, const PlantedTree* planted);

// Where a geometry's filter functions stand in its object, found in the same way; throws Doubt when
// they are not found.
struct FilterPlaces {
  std::size_t intersect;
  std::size_t occluded;
};
FilterPlaces find_filters(RTCDevice device);

}  // namespace shim
