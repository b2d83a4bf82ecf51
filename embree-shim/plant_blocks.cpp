// Trees of faces -> nodes, then blocks, in pages: nodes depth first, blocks in the order of the
// leaves.
#include "plant_blocks.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <numeric>
#include <string>

namespace shim {
namespace {

std::uint32_t blocks_of(const PlantNode& leaf) noexcept {
  const std::uint32_t faces = leaf.count & ~leaf_bit;
  return (faces + layout::block_lanes - 1) / layout::block_lanes;
}

// Checks what the kernels rely on, and counts.
class Measure {
 public:
  Measure(const PlantTree& tree, int width) : tree_(tree), width_(width) {
    std::vector<Path> open{{0, 1, 1}};
    while (!open.empty()) {
      const Path at = open.back();
      open.pop_back();
      const PlantNode& node = tree.nodes[at.node];
      stack_ = std::max(stack_, at.stack);
      // As deep as the live reader goes.
      if (at.depth >= layout::max_depth) throw Doubt("the file's tree is more than 100 levels deep");
      if (node.count & leaf_bit) {
        count_leaf(node);
        continue;
      }
      if (node.count > static_cast<std::uint32_t>(width_)) {
        throw Doubt("the file's tree has a node of " + std::to_string(node.count) +
                    " children, and the scene's are " + std::to_string(width_) + " wide");
      }
      nodes_++;
      // All children but the one that is followed wait on the stack.
      const std::uint32_t stack = at.stack + node.count - 1;
      if (stack > layout::stack_entries(width_)) {
        throw Doubt("the file's tree needs a deeper stack than Embree's kernels have");
      }
      for (std::uint32_t child = 0; child < node.count; child++) {
        open.push_back({node.first + child, at.depth + 1, stack});
      }
    }
  }

  std::uint64_t nodes() const noexcept { return nodes_; }
  std::uint64_t blocks() const noexcept { return blocks_; }
  std::uint32_t stack() const noexcept { return stack_; }

 private:
  struct Path {
    std::uint32_t node;
    std::uint32_t depth;
    std::uint32_t stack;
  };

  void count_leaf(const PlantNode& leaf) {
    const std::uint32_t blocks = blocks_of(leaf);
    if (blocks > layout::max_blocks) {
      throw Doubt("the file's tree has a leaf of " + std::to_string(leaf.count & ~leaf_bit) +
                  " primitives, and Embree's have at most " +
                  std::to_string(layout::max_blocks * layout::block_lanes));
    }
    blocks_ += blocks;
  }

  const PlantTree& tree_;
  int width_;
  std::uint64_t nodes_ = 0;
  std::uint64_t blocks_ = 0;
  std::uint32_t stack_ = 1;
};

// Which child each slot of a node holds. Any hit takes the last slot that it hits first, always,
// and Embree has the child with most primitives in the first one.
void fill_slots(const PlantTree& tree, const PlantNode& node, std::uint8_t* slots) {
  std::uint8_t* end = slots + node.count;
  std::iota(slots, end, std::uint8_t{0});
  switch (node.visits) {
    case Visits::first_first: std::reverse(slots, end); break;
    case Visits::last_first: break;
    case Visits::by_size:
      std::stable_sort(slots, end, [&](std::uint8_t a, std::uint8_t b) {
        return tree.nodes[node.first + a].faces > tree.nodes[node.first + b].faces;
      });
      break;
  }
}

// The lane of a block that no face is in. Kernels of words read vertices of all lanes, so theirs is
// a triangle without area of a geometry that exists, as Embree has it.
void fill_empty_lane(const layout::Block& block, unsigned char* at, std::size_t lane) noexcept {
  const auto write = [&](std::size_t row, std::uint32_t value) {
    std::memcpy(at + (row * layout::block_lanes + lane) * sizeof value, &value, sizeof value);
  };
  const std::size_t ids = block.geometry / (layout::block_lanes * sizeof(std::uint32_t));
  std::uint32_t geometry = layout::no_primitive;
  if (block.contents == layout::Contents::words) {
    std::uint32_t word;
    std::memcpy(&word, at, sizeof word);
    for (std::size_t row = 0; row < block.corners; row++) write(row, word);
    std::memcpy(&geometry, at + block.geometry, sizeof geometry);
  }
  write(ids, geometry);
  write(ids + 1, layout::no_primitive);
}

template <int width>
class Maker {
 public:
  Maker(const PlantTree& tree, const FileFaces& faces, const layout::Block& block,
        const LaneCheck& lanes)
      : tree_(tree), faces_(faces), block_(block), lanes_(lanes), measure_(tree, width) {}

  PlantedBlocks make() {
    const std::size_t node_bytes = measure_.nodes() * sizeof(layout::BoxNode<width>);
    PlantedBlocks made;
    made.pages = Pages(node_bytes + measure_.blocks() * block_.bytes);
    made.width = width;
    made.nodes = measure_.nodes();
    made.blocks = measure_.blocks();
    made.stack = measure_.stack();
    made.first_node = reinterpret_cast<std::uintptr_t>(made.pages.data());
    made.places.resize(width * made.nodes);
    give_places(made.pages.data(), made.pages.data() + node_bytes);
    std::uint8_t* places = made.places.data();
    for (std::size_t index = 0; index < tree_.nodes.size(); index++) {
      if (tree_.nodes[index].count & leaf_bit) {
        fill_leaf(index);
      } else {
        fill_node(index, places);
        places += width;
      }
    }
    made.root = references_[0];
    made.pages.make_read_only();
    return made;
  }

 private:
  // Nodes and blocks in the order of the tree's nodes: siblings lie together.
  void give_places(unsigned char* node, unsigned char* block) {
    references_.reserve(tree_.nodes.size());
    for (const PlantNode& here : tree_.nodes) {
      if (here.count & leaf_bit) {
        const std::uint32_t blocks = blocks_of(here);
        references_.push_back(reinterpret_cast<std::uintptr_t>(block) | (layout::tag_leaf + blocks));
        block += blocks * block_.bytes;
      } else {
        references_.push_back(reinterpret_cast<std::uintptr_t>(node) | layout::tag_box);
        node += sizeof(layout::BoxNode<width>);
      }
    }
  }

  template <typename T>
  T* memory_of(std::size_t index) const noexcept {
    return reinterpret_cast<T*>(references_[index] & ~layout::tag_mask);
  }

  void fill_node(std::size_t index, std::uint8_t* places) const {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    const PlantNode& node = tree_.nodes[index];
    auto& made = *memory_of<layout::BoxNode<width>>(index);
    fill_slots(tree_, node, places);
    for (std::uint32_t slot = 0; slot < width; slot++) {
      // Packets stop at the first slot that is empty, so all of those are at the end.
      const bool empty = slot >= node.count;
      const std::uint32_t child = empty ? 0 : node.first + places[slot];
      made.children[slot] = empty ? layout::nothing : references_[child];
      for (int axis = 0; axis < 3; axis++) {
        const Bounds& bounds = tree_.nodes[child].bounds;
        made.bounds[axis][0][slot] = empty ? infinity : bounds.lower[axis];
        made.bounds[axis][1][slot] = empty ? -infinity : bounds.upper[axis];
      }
    }
  }

  void fill_leaf(std::size_t index) const {
    const PlantNode& leaf = tree_.nodes[index];
    const std::size_t faces = leaf.count & ~leaf_bit;
    auto* first = memory_of<unsigned char>(index);
    for (std::size_t entry = 0; entry < blocks_of(leaf) * layout::block_lanes; entry++) {
      unsigned char* block = first + entry / layout::block_lanes * block_.bytes;
      const std::size_t lane = entry % layout::block_lanes;
      if (entry < faces) {
        fill_lane(block, lane, tree_.faces[leaf.first + entry]);
      } else {
        fill_empty_lane(block_, block, lane);
      }
    }
  }

  void fill_lane(unsigned char* block, std::size_t lane, Face face) const {
    const Part& part = faces_.parts()[face.geometry];
    const auto at = [&](std::size_t row) {
      return block + (row * layout::block_lanes + lane) * sizeof(std::uint32_t);
    };
    if (block_.contents == layout::Contents::words) {
      const auto& words = lanes_.words_of(face);
      for (std::uint32_t corner = 0; corner < part.corners; corner++) {
        std::memcpy(at(corner), &words[corner], sizeof(std::uint32_t));
      }
    } else {
      const LaneFloats floats = lane_floats(part, face.number, block_.contents);
      for (std::uint32_t row = 0; row < 3 * part.corners; row++) {
        std::memcpy(at(row), &floats[row], sizeof(float));
      }
    }
    const std::size_t ids = block_.geometry / (layout::block_lanes * sizeof(std::uint32_t));
    std::memcpy(at(ids), &face.geometry, sizeof face.geometry);
    std::memcpy(at(ids + 1), &face.number, sizeof face.number);
  }

  const PlantTree& tree_;
  const FileFaces& faces_;
  const layout::Block& block_;
  const LaneCheck& lanes_;
  Measure measure_;
  std::vector<std::uint64_t> references_;  // by node
};

}  // namespace

LaneFloats lane_floats(const Part& part, std::uint32_t face, layout::Contents contents) noexcept {
  LaneFloats floats{};
  for (std::uint32_t corner = 0; corner < part.corners; corner++) {
    const auto position = part.vertex(face, corner);
    std::copy(position.begin(), position.end(), floats.begin() + 3 * corner);
  }
  if (contents == layout::Contents::edges) {
    for (std::size_t axis = 0; axis < 3; axis++) {
      floats[3 + axis] = floats[axis] - floats[3 + axis];
      floats[6 + axis] = floats[6 + axis] - floats[axis];
    }
  }
  return floats;
}

PlantedBlocks plant_blocks(const PlantTree& tree, const FileFaces& faces, const LiveBvh& bvh,
                           const LaneCheck& lanes) {
  if (bvh.width == 8) return Maker<8>(tree, faces, *bvh.block, lanes).make();
  return Maker<4>(tree, faces, *bvh.block, lanes).make();
}

}  // namespace shim
