// What is found in the memory of a committed scene: its BVHs, and the tree that they are
// (live_bvh.cpp).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "embree_layout.hpp"
#include "memory.hpp"
#include "tree.hpp"

namespace shim {

// One BVH of a scene that has something in it, and of which everything was checked but its nodes.
struct LiveBvh {
  int width;                    // 4 or 8
  const layout::Block* block;   // what its leaves hold; null: instances
  std::uint64_t root;           // the reference at which every query starts
  std::uint64_t root_address;   // where that reference stands
  Bounds bounds;
  std::string isa;
  bool quantised = false;       // known once its nodes have been read
};

// Is shown every lane of every block, as it stands in a leaf: what the tree does not tell.
class LaneSink {
 public:
  virtual ~LaneSink() = default;
  // Throws Doubt when the lane is not what it must be. `block` are the block's bytes.
  virtual void see(const LiveBvh& bvh, const unsigned char* block, std::size_t lane, std::uint32_t geometry,
                   std::uint32_t face, Memory& memory) = 0;
};

// Says in which order the children of a node are told, where that is not the order of its slots.
class SlotOrder {
 public:
  virtual ~SlotOrder() = default;
  // The place, among its siblings, of the child in each slot that has one; null when slots are in
  // order.
  virtual const std::uint8_t* places(std::uint64_t node) const noexcept = 0;
};

// The BVHs of the scene, found and checked anew; the order is that of the scene's list. Throws
// Doubt.
std::vector<LiveBvh> find_live_bvhs(const Attached& scene, const ShimFault* fault);

// The BVHs and, through them, the tree. `lanes` and `order` may be null. Throws Doubt at the first
// check that fails; a fault, for tests, falsifies what is read.
struct LiveScene {
  std::vector<LiveBvh> bvhs;
  Tree tree;
};
LiveScene read_live_scene(const Attached& scene, const ShimFault* fault, LaneSink* lanes, const SlotOrder* order);

// The tree below roots that the scene does not have (yet), with all checks of nodes and leaves.
Tree read_tree_below(const Attached& scene, std::vector<LiveBvh> bvhs, const SlotOrder* order);

}  // namespace shim
