// A checked file's tree, restricted to the faces of one kind.
#include "plant_tree.hpp"

#include <algorithm>
#include <utility>

namespace shim {
namespace {

Bounds intersection(const Bounds& a, const Bounds& b) noexcept {
  Bounds both;
  for (int axis = 0; axis < 3; axis++) {
    both.lower[axis] = std::max(a.lower[axis], b.lower[axis]);
    both.upper[axis] = std::min(a.upper[axis], b.upper[axis]);
  }
  return both;
}

Visits visits_of(const ShimTreeFile& file, std::uint32_t node) noexcept {
  // Rules of ORDR; the others look at the ray, which the slots of a node cannot.
  constexpr std::uint8_t first_child_first = 1;
  constexpr std::uint8_t last_child_first = 2;
  const std::uint8_t rule = file.order == nullptr ? 0 : file.order[node];
  if (rule == first_child_first) return Visits::first_first;
  return rule == last_child_first ? Visits::last_first : Visits::by_size;
}

class Restriction {
 public:
  Restriction(const ShimTreeFile& file, const FileFaces& faces, std::uint32_t corners)
      : file_(file),
        faces_(faces),
        corners_(corners),
        splits_((file.flags & SHIM_FILE_SPLITS) != 0),
        below_(file.node_count) {}

  PlantTree run() {
    for (std::uint64_t index = file_.node_count; index-- > 0;) {
      const auto node = static_cast<std::uint32_t>(index);
      (file_.nodes[node].count & leaf_bit) ? look_at_leaf(node) : look_at_children(node);
    }
    if (below_[0].faces == 0) return {};
    tree_.splits = splits_;
    tree_.nodes.resize(1);
    open_.push_back({0, 0});
    while (!open_.empty()) {
      const auto [from, to] = open_.back();
      open_.pop_back();
      emit(from, to);
    }
    return std::move(tree_);
  }

 private:
  // What is left of a node of the file.
  struct Below {
    Bounds bounds;
    std::uint32_t faces = 0;
    std::uint32_t children = 0;  // that have faces
    bool changed = false;        // something below is not, or not only, what the file has there
  };

  struct Open {
    std::uint32_t from;  // node of the file
    std::uint32_t to;    // node of the tree
  };

  // Calls `found(face)` for the faces of a leaf, each once; returns whether that is all that the
  // leaf has, and no more.
  template <typename Found>
  bool each_face(const ShimNode& leaf, Found&& found) const {
    const std::uint32_t* entries = file_.primitives + leaf.first;
    const std::uint32_t count = leaf.count & ~leaf_bit;
    bool all = true;
    for (std::uint32_t entry = 0; entry < count; entry++) {
      const std::uint32_t triangle = entries[entry];
      const Face face = faces_.face_of(triangle);
      const Part& part = faces_.parts()[face.geometry];
      if (part.corners != corners_) {
        all = false;
        continue;
      }
      if (corners_ == 3) {
        found(face);
        continue;
      }
      const std::uint32_t first = faces_.triangle_of(face);
      const std::uint32_t other = triangle == first ? first + 1 : first;
      const std::uint32_t* twin = std::find(entries, entries + count, other);
      const bool both = twin != entries + count;
      all = all && both;
      // With its twin beside it, the first of the two that comes brings the quad.
      const bool brings = both ? twin > entries + entry : splits_ || triangle == first;
      if (brings) found(face);
    }
    return all;
  }

  void look_at_leaf(std::uint32_t index) {
    const ShimNode& leaf = file_.nodes[index];
    Below& below = below_[index];
    Bounds box;
    std::copy(leaf.lower, leaf.lower + 3, box.lower);
    std::copy(leaf.upper, leaf.upper + 3, box.upper);
    const bool all = each_face(leaf, [&](Face) { below.faces++; });
    below.bounds = box;
    below.changed = !all;
    if (all) return;
    // A quad of which a half stands elsewhere may stick out, and what is not there needs no room.
    below.bounds = Bounds::empty();
    each_face(leaf, [&](Face face) {
      const Part& part = faces_.parts()[face.geometry];
      for (std::uint32_t half = 0; half < part.triangles_per_face(); half++) {
        const Bounds bounds = part.bounds(face.number, half);
        if (!splits_) below.bounds.extend(bounds);
        if (splits_ && box.overlaps(bounds)) below.bounds.extend(intersection(bounds, box));
      }
    });
  }

  void look_at_children(std::uint32_t index) {
    const ShimNode& node = file_.nodes[index];
    Below& below = below_[index];
    Bounds needed = Bounds::empty();
    for (std::uint32_t child = node.first; child < node.first + node.count; child++) {
      below.changed = below.changed || below_[child].changed || below_[child].faces == 0;
      if (below_[child].faces == 0) continue;
      below.faces += below_[child].faces;
      below.children++;
      needed.extend(below_[child].bounds);
    }
    below.bounds = needed;
    if (below.changed) return;
    std::copy(node.lower, node.lower + 3, below.bounds.lower);
    std::copy(node.upper, node.upper + 3, below.bounds.upper);
  }

  // The node that stands where `index` did: one that has lost all children but one is that one.
  std::uint32_t standing(std::uint32_t index) const noexcept {
    for (;;) {
      const ShimNode& node = file_.nodes[index];
      if ((node.count & leaf_bit) || node.count == 1 || below_[index].children > 1) return index;
      std::uint32_t child = node.first;
      while (below_[child].faces == 0) child++;
      index = child;
    }
  }

  void emit(std::uint32_t from, std::uint32_t to) {
    from = standing(from);
    const ShimNode& node = file_.nodes[from];
    PlantNode here{below_[from].bounds, 0, 0, below_[from].faces, visits_of(file_, from)};
    if (node.count & leaf_bit) {
      here.first = static_cast<std::uint32_t>(tree_.faces.size());
      here.count = leaf_bit | here.faces;
      each_face(node, [&](Face face) { tree_.faces.push_back(face); });
    } else {
      here.first = static_cast<std::uint32_t>(tree_.nodes.size());
      here.count = below_[from].children;
      tree_.nodes.resize(tree_.nodes.size() + here.count);
      std::uint32_t place = here.first + here.count;
      for (std::uint32_t child = node.first + node.count; child-- > node.first;) {
        if (below_[child].faces != 0) open_.push_back({child, --place});
      }
    }
    tree_.nodes[to] = here;
  }

  const ShimTreeFile& file_;
  const FileFaces& faces_;
  std::uint32_t corners_;
  bool splits_;
  std::vector<Below> below_;
  std::vector<Open> open_;
  PlantTree tree_;
};

// Adds one tree to what the live reader would make; `root` is the node that its root becomes.
void add_read_back(const PlantTree& tree, const FileFaces& faces, std::uint32_t root, Tree& into) {
  const auto base = static_cast<std::uint32_t>(into.nodes.size() - 1);
  const auto place = [&](std::uint32_t node) { return node == 0 ? root : base + node; };
  into.nodes.resize(into.nodes.size() + tree.nodes.size() - 1);
  // Depth first, the first child's subtree next, is the order in which nodes are stored: a leaf's
  // entries follow those of the leaf before it.
  std::vector<std::uint32_t> open{0};
  while (!open.empty()) {
    const std::uint32_t index = open.back();
    open.pop_back();
    const PlantNode& node = tree.nodes[index];
    const std::uint32_t at = place(index);
    into.set_bounds(at, node.bounds);
    if (!(node.count & leaf_bit)) {
      into.nodes[at].first = place(node.first);
      into.nodes[at].count = node.count;
      for (std::uint32_t child = node.count; child-- > 0;) open.push_back(node.first + child);
      continue;
    }
    into.make_leaf(at);
    for (std::uint32_t entry = 0; entry < (node.count & ~leaf_bit); entry++) {
      const Face face = tree.faces[node.first + entry];
      const Part& part = faces.parts()[face.geometry];
      for (std::uint32_t half = 0; half < part.triangles_per_face(); half++) {
        if (tree.splits && !node.bounds.overlaps(part.bounds(face.number, half))) continue;
        into.add_primitive(at, faces.triangle_of(face) + half);
      }
    }
  }
}

}  // namespace

PlantTree plant_tree(const ShimTreeFile& file, const FileFaces& faces, std::uint32_t corners) {
  return Restriction(file, faces, corners).run();
}

Tree read_back(const std::vector<PlantTree>& trees, const FileFaces& faces) {
  Tree all;
  all.nodes.resize(1);
  if (trees.size() == 1) {
    add_read_back(trees[0], faces, 0, all);
    return all;
  }
  Bounds bounds = Bounds::empty();
  for (const PlantTree& tree : trees) bounds.extend(tree.nodes[0].bounds);
  all.set_bounds(0, bounds);
  const std::uint32_t first = all.make_inner(0, static_cast<std::uint32_t>(trees.size()));
  for (std::size_t index = 0; index < trees.size(); index++) {
    add_read_back(trees[index], faces, first + static_cast<std::uint32_t>(index), all);
  }
  return all;
}

}  // namespace shim
