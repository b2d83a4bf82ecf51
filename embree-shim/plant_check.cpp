// The tree of a `.bvh`, checked without believing whoever made it: first what must hold before an
// index may be followed, then what makes every answer right.
#include <algorithm>
#include <cmath>
#include <string>

#include "embree_layout.hpp"
#include "memory.hpp"
#include "plant_cover.hpp"
#include "plant_file.hpp"
#include "ray_check.hpp"
#include "tree.hpp"

namespace shim {
namespace {

Bounds bounds_of(const ShimNode& node) noexcept {
  Bounds bounds;
  std::copy(node.lower, node.lower + 3, bounds.lower);
  std::copy(node.upper, node.upper + 3, bounds.upper);
  return bounds;
}

bool is_finite(const Bounds& bounds) noexcept {
  bool finite = true;
  for (int axis = 0; axis < 3; axis++) {
    finite = finite && std::fabs(bounds.lower[axis]) < embree_large;
    finite = finite && std::fabs(bounds.upper[axis]) < embree_large;
  }
  return finite;
}

// A leaf of Embree's for each of two kinds of faces, of which one has two triangles. What exactly
// fits is known when the kinds are apart.
constexpr std::uint64_t most_entries = 3 * layout::max_blocks * layout::block_lanes;

class Check {
 public:
  Check(const ShimTreeFile& file, const FileFaces& faces)
      : file_(file), faces_(faces), splits_((file.flags & SHIM_FILE_SPLITS) != 0) {}

  void run() {
    find_kept();
    if (file_.node_count == 0) throw Doubt("the file's tree has no node");
    // Indices have 32 bits.
    if (file_.node_count > 0xFFFFFFFFu || file_.primitive_count > 0xFFFFFFFFu) {
      throw Doubt("the file's tree is too large");
    }
    // The tree of an empty scene: one leaf without a triangle, whose box is nothing.
    const bool empty = file_.node_count == 1 && file_.nodes[0].count == leaf_bit;
    if (!empty) check_nodes();
    check_faces();
    if (splits_) check_covered(std::move(parts_), faces_);
  }

 private:
  // Children stand behind their parent and have no other, so there is no cycle, and all is reached.
  void check_nodes() {
    std::vector<bool> has_parent(file_.node_count);
    std::uint64_t parents = 0;
    for (std::uint64_t index = 0; index < file_.node_count; index++) {
      const ShimNode& node = file_.nodes[index];
      const Bounds bounds = bounds_of(node);
      if (!is_finite(bounds)) throw Doubt("a box of the file's tree is not finite");
      if (!bounds.is_proper()) throw Doubt("a box of the file's tree is inverted");
      if (node.count & leaf_bit) {
        check_leaf(node, bounds);
        continue;
      }
      const std::uint64_t end = std::uint64_t{node.first} + node.count;
      if (node.count == 0 || node.first <= index || end > file_.node_count) {
        throw Doubt("an inner node of the file's tree has no children behind it");
      }
      for (std::uint64_t child = node.first; child < end; child++) {
        if (has_parent[child]) throw Doubt("a node of the file's tree has two parents");
        has_parent[child] = true;
        if (!bounds.contains(bounds_of(file_.nodes[child]))) {
          throw Doubt("a box of the file's tree is not inside its parent's");
        }
      }
      parents += node.count;
    }
    if (parents != file_.node_count - 1) throw Doubt("a node of the file's tree has no parent");
  }

  void check_leaf(const ShimNode& leaf, const Bounds& box) {
    const std::uint64_t count = leaf.count & ~leaf_bit;
    const std::uint64_t end = leaf.first + count;
    if (count == 0) throw Doubt("a leaf of the file's tree is empty");
    if (count > most_entries) {
      throw Doubt("a leaf of the file's tree has " + std::to_string(count) + " triangles, and Embree's " +
                  "have at most " + std::to_string(layout::max_blocks * layout::block_lanes));
    }
    if (end > file_.primitive_count) throw Doubt("a leaf of the file's tree ends beyond its entries");
    // A leaf may be named again and again, but no more entries are looked at than the file has.
    entries_ += count;
    if (entries_ > file_.primitive_count) throw Doubt("leaves of the file's tree share entries");
    for (std::uint64_t entry = leaf.first; entry < end; entry++) {
      fetch_ahead(entry);
      check_entry(file_.primitives[entry], box);
    }
  }

  // Leaves are in the order of the tree, vertices in that of the geometries: most are not in a cache.
  void fetch_ahead(std::uint64_t entry) const noexcept {
    constexpr std::uint64_t entries_ahead = 16;
    constexpr std::uint64_t floats_per_triangle = 9;
    if (entry + entries_ahead >= file_.primitive_count) return;
    const std::uint64_t triangle = file_.primitives[entry + entries_ahead];
    if (triangle >= file_.triangle_count) return;
    const float* vertices = file_.triangles + floats_per_triangle * triangle;
    __builtin_prefetch(vertices);
    __builtin_prefetch(vertices + floats_per_triangle - 1);
  }

  void check_entry(std::uint32_t triangle, const Bounds& box) {
    if (triangle >= faces_.triangle_count() || !faces_.owned(triangle)) {
      throw Doubt("a leaf of the file's tree names a triangle that no geometry has");
    }
    const Face face = faces_.face_of(triangle);
    const Part& part = faces_.parts()[face.geometry];
    if (!kept_[triangle]) {
      throw Doubt("a leaf of the file's tree names a triangle that Embree cannot have kept");
    }
    const std::uint32_t half = triangle - faces_.triangle_of(face);
    const Bounds bounds = part.bounds(face.number, half);
    const bool whole = box.contains(bounds);
    if (!splits_) {
      if (!whole) throw Doubt("a leaf's box in the file's tree does not contain its triangle");
      if (leaves_[triangle] != none) {
        throw Doubt("a triangle of the file's tree stands in two leaves without spatial splits");
      }
    } else if (!box.overlaps(bounds)) {
      throw Doubt("a leaf's box in the file's tree is away from its triangle");
    }
    if (whole) {
      leaves_[triangle] = held;
      return;
    }
    if (leaves_[triangle] == none) leaves_[triangle] = in_parts;
    parts_.push_back({triangle, box});
  }

  void find_kept() {
    leaves_.resize(faces_.triangle_count());
    kept_.resize(faces_.triangle_count());
    for (const Part& part : faces_.parts()) {
      std::uint64_t triangle = part.first_triangle;
      for (std::uint64_t face = 0; face < part.faces; face++) {
        const bool kept = part.keeps(face);
        for (std::uint32_t half = 0; half < part.triangles_per_face(); half++) {
          kept_[triangle++] = kept;
        }
      }
    }
  }

  void check_faces() {
    for (std::uint64_t triangle = 0; triangle < faces_.triangle_count(); triangle++) {
      if (kept_[triangle] && leaves_[triangle] == none) {
        throw Doubt("a triangle of the file stands in no leaf of its tree");
      }
    }
    // What one leaf holds as a whole needs no others.
    const auto whole = [this](const ClippedTriangle& part) { return leaves_[part.triangle] == held; };
    parts_.erase(std::remove_if(parts_.begin(), parts_.end(), whole), parts_.end());
  }

  // Where a triangle stands.
  enum Standing : std::uint8_t { none, in_parts, held };

  const ShimTreeFile& file_;
  const FileFaces& faces_;
  bool splits_;
  std::uint64_t entries_ = 0;
  std::vector<bool> kept_;            // by triangle
  std::vector<std::uint8_t> leaves_;  // Standing by triangle
  std::vector<ClippedTriangle> parts_;
};

}  // namespace

void check_file_tree(const ShimTreeFile& file, const FileFaces& faces) { Check(file, faces).run(); }

}  // namespace shim
