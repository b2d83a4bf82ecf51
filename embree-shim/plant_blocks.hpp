// The nodes and leaves that Embree's kernels read, made of trees of faces.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "live_bvh.hpp"
#include "pages.hpp"
#include "plant_lanes.hpp"
#include "plant_tree.hpp"

namespace shim {

// The numbers of a lane, by row of its block: x, y and z of each corner, or of what stands for it.
using LaneFloats = std::array<float, 12>;
LaneFloats lane_floats(const Part& part, std::uint32_t face, layout::Contents contents) noexcept;

// A tree in memory, to be referred to by `root`.
struct PlantedBlocks {
  Pages pages;
  std::uint64_t root = layout::nothing;
  std::uint64_t first_node = 0;  // address; the nodes are adjacent
  std::uint32_t width = 0;
  std::uint64_t nodes = 0;
  std::uint64_t blocks = 0;
  std::uint32_t stack = 0;            // entries that a traversal needs at most
  std::vector<std::uint8_t> places;   // of each node's slots: which child it holds
};

// Makes nodes and blocks of the kinds that `bvh` has. Throws Doubt when the tree is wider or deeper
// than its kernels can follow, or a leaf too large.
PlantedBlocks plant_blocks(const PlantTree& tree, const FileFaces& faces, const LiveBvh& bvh,
                           const LaneCheck& lanes);

}  // namespace shim
