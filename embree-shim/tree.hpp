// A tree on its way out, as the files have it; and what both sources of trees share.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "faces.hpp"
#include "memory.hpp"
#include "shim.h"

namespace shim {

class Scene;

constexpr std::uint32_t leaf_bit = 0x80000000u;

// An entry of Tree::primitives that stands for an instance: this bit, and the geomID of the instance.
constexpr std::uint32_t instance_bit = 0x80000000u;

// Nodes and primitives in the order of NODE and PRIM: children adjacent, behind their parent, depth first.
struct Tree {
  std::vector<ShimNode> nodes;
  std::vector<std::uint32_t> primitives;
  std::string producer;
  bool splits = false;  // a triangle stands in several leaves, or a leaf's box is clipped

  // Adds room for `count` adjacent children of `parent` and makes it an inner node; returns the index of the first.
  std::uint32_t make_inner(std::uint32_t parent, std::uint32_t count);
  void make_leaf(std::uint32_t node) noexcept;  // empty; `add_primitive` fills it, before any other leaf is made
  void add_primitive(std::uint32_t node, std::uint32_t triangle);
  void set_bounds(std::uint32_t node, const Bounds& bounds) noexcept;
  Bounds bounds(std::uint32_t node) const noexcept;
};

// Reads the tree that Embree traverses from its memory; throws Doubt at the first check that fails. A fault, for tests,
// falsifies what is read.
Tree read_live_tree(const Attached& scene, const ShimFault* fault);

// Builds a binary tree with one triangle a leaf with rtcBuildBVH.
Tree build_tree(const Scene& scene);

// "embree 3.13.5".
std::string library_name(std::uint32_t version);

}  // namespace shim
