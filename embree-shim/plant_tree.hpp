// A file's tree on its way into one of Embree's BVHs: over faces, those of one kind.
#pragma once

#include <cstdint>
#include <vector>

#include "plant_file.hpp"
#include "tree.hpp"

namespace shim {

// In which order any hit visits the children of a node.
enum class Visits : std::uint8_t { by_size, first_first, last_first };

struct PlantNode {
  Bounds bounds;
  std::uint32_t first;  // of its children, adjacent and behind it, or of its faces
  std::uint32_t count;  // as in ShimNode
  std::uint32_t faces;  // in all leaves below
  Visits visits;
};

// Nodes depth first, faces in the order of the leaves: what the live reader makes of it has the
// same order.
struct PlantTree {
  std::vector<PlantNode> nodes;  // empty: there is no face of that kind
  std::vector<Face> faces;
  bool splits = false;  // a face may stand in several leaves
};

// What of a checked tree is over faces of `corners` corners. Nodes over nothing else go away, and
// so do those that one child is left of. Both triangles of a quad are one face, in the leaf of the
// first one, whose box grows; with spatial splits, in each leaf that has either.
PlantTree plant_tree(const ShimTreeFile& file, const FileFaces& faces, std::uint32_t corners);

// The trees as the live reader tells them: one, or several under an added root.
Tree read_back(const std::vector<PlantTree>& trees, const FileFaces& faces);

}  // namespace shim
