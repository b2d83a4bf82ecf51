// A tree on its way out: nodes and primitives in the order of the files.
#include "tree.hpp"

#include <algorithm>

namespace shim {

std::uint32_t Tree::make_inner(std::uint32_t parent, std::uint32_t count) {
  const auto first = static_cast<std::uint32_t>(nodes.size());
  nodes.resize(nodes.size() + count);
  nodes[parent].first = first;
  nodes[parent].count = count;
  return first;
}

void Tree::make_leaf(std::uint32_t node) noexcept {
  nodes[node].first = static_cast<std::uint32_t>(primitives.size());
  nodes[node].count = leaf_bit;
}

void Tree::add_primitive(std::uint32_t node, std::uint32_t triangle) {
  primitives.push_back(triangle);
  nodes[node].count++;
}

void Tree::set_bounds(std::uint32_t node, const Bounds& bounds) noexcept {
  std::copy(bounds.lower, bounds.lower + 3, nodes[node].lower);
  std::copy(bounds.upper, bounds.upper + 3, nodes[node].upper);
}

Bounds Tree::bounds(std::uint32_t node) const noexcept {
  Bounds bounds;
  std::copy(nodes[node].lower, nodes[node].lower + 3, bounds.lower);
  std::copy(nodes[node].upper, nodes[node].upper + 3, bounds.upper);
  return bounds;
}

std::string library_name(std::uint32_t version) {
  return "embree " + std::to_string(version / 10000) + "." + std::to_string(version / 100 % 100) + "." +
         std::to_string(version % 100);
}

}  // namespace shim
