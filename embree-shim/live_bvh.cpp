// Reads the tree that Embree traverses from its memory, right after the commit: scene -> list of wrappers -> BVHs -> nodes
// and leaves -> Tree, as it is: wide nodes stay wide, a leaf of several blocks is one leaf.
//
// The layout is no interface of Embree's, so nothing is believed: every address is checked before it is read (memory.hpp),
// every fact that can be checked is (the functions named check_*), and the first one that does not hold throws a Doubt.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "live_bvh.hpp"

namespace shim {
namespace {

using layout::Accel;
using layout::Block;

template <typename T>
T read(Memory& memory, Object object, std::uint64_t address) {
  T value;
  memory.read(object, address, &value, sizeof value);
  return value;
}

Bounds bounds_of(const Accel& accel, int time) noexcept {
  Bounds bounds;
  std::copy(accel.bounds[time][0], accel.bounds[time][0] + 3, bounds.lower);
  std::copy(accel.bounds[time][1], accel.bounds[time][1] + 3, bounds.upper);
  return bounds;
}

// A reference that is still to be followed into node `node` of the tree.
struct Pending {
  std::uint64_t reference;
  std::uint32_t node;
  std::uint32_t depth;
  std::uint32_t bvh;
};

class Reader {
 public:
  Reader(const Attached& scene, Memory& memory, std::uint32_t version, Image image)
      : scene_(scene), memory_(memory), version_(version), image_(std::move(image)) {}

  void show(LaneSink* lanes, const SlotOrder* order) noexcept {
    lanes_ = lanes;
    order_ = order;
  }

  // The way from the scene to its BVHs.
  std::vector<LiveBvh> find_bvhs() {
    check_library();
    const std::vector<std::uint64_t> wrappers = read_scene();
    for (const std::uint64_t wrapper : wrappers) read_accel(wrapper);
    check_bounds();
    return bvhs_;
  }

  LiveScene read_tree(std::vector<LiveBvh> bvhs) {
    bvhs_ = std::move(bvhs);
    count_expected();
    start();
    while (!pending_.empty()) {
      const Pending next = pending_.back();
      pending_.pop_back();
      follow(next);
    }
    check_primitives();
    name_producer();
    return {std::move(bvhs_), std::move(tree_)};
  }

 private:
  void check_library() const {
    if (version_ != layout::version) {
      throw Doubt("Embree's version is " + std::to_string(version_) + ", and the layout is known of " +
                  std::to_string(layout::version) + " only");
    }
    if (image_.segments.empty()) throw Doubt("the image of libembree3 is not found in this process");
  }

  // Checks the scene object, and returns the wrappers in its list.
  std::vector<std::uint64_t> read_scene() {
    const auto address = reinterpret_cast<std::uintptr_t>(scene_.scene);
    const Accel accel = read<Accel>(memory_, Object::scene, address);
    check_vtable(accel, "the scene");
    if (!(bounds_of(accel, 0) == scene_.bounds[0]) || !(bounds_of(accel, 1) == scene_.bounds[1])) {
      throw Doubt("the scene's bounds differ from those of rtcGetSceneLinearBounds");
    }
    const auto list = read<layout::Vector>(memory_, Object::scene, address + layout::scene_accels);
    constexpr std::uint64_t most = 64;  // one per kind of geometry: a scene of ours has at most two
    if (list.begin > list.end || list.end > list.capacity || (list.end - list.begin) % 8 != 0 ||
        (list.end - list.begin) / 8 > most) {
      throw Doubt("the scene's list of acceleration structures is not a list");
    }
    std::vector<std::uint64_t> wrappers((list.end - list.begin) / 8);
    if (!wrappers.empty()) memory_.read(Object::accel_list, list.begin, wrappers.data(), 8 * wrappers.size());
    return wrappers;
  }

  // Checks a wrapper and its BVH, and adds it to the BVHs unless it is empty.
  void read_accel(std::uint64_t address) {
    const auto wrapper = read<layout::Wrapper>(memory_, Object::accel, address);
    check_vtable(wrapper.accel, "an acceleration structure");
    if (wrapper.accel.type != layout::type_wrapper) {
      throw Doubt("an acceleration structure of the scene has type " + std::to_string(wrapper.accel.type));
    }
    const auto bvh = read<layout::Bvh>(memory_, Object::bvh, wrapper.bvh);
    check_vtable(bvh.accel, "a BVH");
    if (bvh.accel.type != layout::type_bvh4 && bvh.accel.type != layout::type_bvh8) {
      throw Doubt("a BVH has the unknown type " + std::to_string(bvh.accel.type));
    }
    if (bvh.device != reinterpret_cast<std::uintptr_t>(scene_.device)) {
      throw Doubt("a BVH does not point back to its device");
    }
    if (bvh.scene != reinterpret_cast<std::uintptr_t>(scene_.scene)) {
      throw Doubt("a BVH does not point back to its scene");
    }
    if (bvh.root == layout::nothing) return;
    LiveBvh found;
    found.bounds = bounds_of(bvh.accel, 0);
    if (!found.bounds.is_proper()) throw Doubt("a BVH's bounds are inverted");
    all_bounds_.extend(found.bounds);
    const std::string primitive = read_primitive_name(bvh.primitive_type);
    const std::string kernel = read_name(wrapper.name);
    found.block = find_block(primitive);
    const bool moving = kernel.find(layout::motion_kernel) != std::string::npos;
    if (moving || (found.block == nullptr && primitive != layout::instance_name)) {
      if (!scene_.others) throw Doubt("the primitive type is unknown: " + printable(moving ? kernel : primitive));
      // Of geometries that are left out, or that move.
      return;
    }
    found.width = bvh.accel.type == layout::type_bvh8 ? 8 : 4;
    found.root = bvh.root;
    found.root_address = wrapper.bvh + offsetof(layout::Bvh, root);
    found.isa = isa_of(kernel, found.width);
    bvhs_.push_back(std::move(found));
  }

  void check_vtable(const Accel& accel, const char* what) const {
    if (!covers(image_.segments, accel.vtable, 8)) {
      throw Doubt(std::string("the vtable of ") + what + " is not in libembree3");
    }
  }

  // The scene's box is that of its BVHs.
  void check_bounds() const {
    const Bounds& whole = scene_.bounds[0];
    // Geometries that are left out may reach further, and may move.
    const bool holds = scene_.others ? whole.contains(all_bounds_) || !whole.is_proper() : all_bounds_ == whole;
    if (!bvhs_.empty() && !holds) throw Doubt("the BVHs' bounds differ from the scene's");
  }

  // A name inside libembree3's image.
  std::string read_name(std::uint64_t address) {
    constexpr std::size_t longest = 96;
    std::string name;
    while (name.size() < longest) {
      if (!covers(image_.segments, address + name.size(), 1)) throw Doubt("a name is not in libembree3");
      const char next = read<char>(memory_, Object::text, address + name.size());
      if (next == '\0') return name;
      name.push_back(next);
    }
    throw Doubt("a name in libembree3 does not end");
  }

  // The name of a primitive type: the first slot of its vtable is a function that returns it. It is not called, but read:
  // `lea rax, [rip + distance]; ret`.
  std::string read_primitive_name(std::uint64_t primitive_type) {
    const auto vtable = read<std::uint64_t>(memory_, Object::vtable, primitive_type);
    if (!covers(image_.segments, vtable, 8)) throw Doubt("the vtable of a primitive type is not in libembree3");
    const auto function = read<std::uint64_t>(memory_, Object::vtable, vtable);
    struct Code {
      std::uint8_t bytes[8];
    };
    if (!covers(image_.code, function, sizeof(Code))) throw Doubt("a primitive type's function is not in libembree3");
    const auto code = read<Code>(memory_, Object::code, function);
    constexpr std::uint8_t load[3] = {0x48, 0x8D, 0x05};
    constexpr std::uint8_t ret = 0xC3;
    if (!std::equal(load, load + 3, code.bytes) || code.bytes[7] != ret) {
      throw Doubt("a primitive type's function does not return a name");
    }
    std::int32_t distance;
    std::memcpy(&distance, code.bytes + 3, sizeof distance);
    return read_name(function + 7 + static_cast<std::uint64_t>(std::int64_t{distance}));
  }

  static const Block* find_block(const std::string& name) {
    for (const Block& block : layout::blocks) {
      if (name == block.name) return &block;
    }
    return nullptr;
  }

  static std::string printable(std::string text) {
    for (char& letter : text) {
      if (letter < ' ' || letter > '~') letter = '?';
    }
    return text;
  }

  // The instruction set in a kernel's name, such as "avx2" in "avx2::BVH8Triangle4Intersector1Moeller".
  static std::string isa_of(const std::string& kernel, int width) {
    const std::size_t colons = kernel.find("::");
    const std::string isa = kernel.substr(0, colons);
    static constexpr const char* known[] = {"sse2", "sse42", "avx", "avx2", "avx512"};
    const bool fits = std::find(std::begin(known), std::end(known), isa) != std::end(known) &&
                      kernel.find("BVH" + std::to_string(width)) != std::string::npos;
    if (colons == std::string::npos || !fits) throw Doubt("the kernel's name is unknown: " + printable(kernel));
    return isa;
  }

  // How many faces the tree must hold.
  void count_expected() {
    kept_.resize(scene_.triangle_count);
    for (const Part& part : scene_.parts) {
      std::uint64_t triangle = part.first_triangle;
      for (std::uint64_t face = 0; face < part.faces; face++, triangle += part.triangles_per_face()) {
        if (!part.keeps(face)) continue;
        kept_[triangle] = true;
        expected_++;
      }
    }
    // Embree's spatial splits replicate at most a fifth of the primitives, those of trees that were planted at most 15 times
    // as many as there are; anything near the limit is not a tree.
    most_references_ = scene_.spatial_splits ? 16 * expected_ + 64 : expected_;
    for (const Part& part : scene_.parts) most_nodes_ += part.instance ? 2 : 0;
    most_nodes_ += 2 * most_references_ + 2 * layout::max_depth;
    seen_.resize(scene_.triangle_count);
    seen_instances_.resize(scene_.parts.size());
  }

  // The root of what there is: of the one BVH, of several under one added node, or of nothing.
  void start() {
    tree_.nodes.resize(1);
    Bounds bounds = Bounds::empty();
    for (const LiveBvh& bvh : bvhs_) bounds.extend(bvh.bounds);
    tree_.set_bounds(0, bounds);
    if (bvhs_.empty()) {
      tree_.make_leaf(0);
    } else if (bvhs_.size() == 1) {
      pending_.push_back({bvhs_[0].root, 0, 1, 0});
    } else {
      const auto count = static_cast<std::uint32_t>(bvhs_.size());
      const std::uint32_t first = tree_.make_inner(0, count);
      for (std::uint32_t index = count; index-- > 0;) {
        tree_.set_bounds(first + index, bvhs_[index].bounds);
        pending_.push_back({bvhs_[index].root, first + index, 2, index});
      }
    }
  }

  void follow(const Pending& at) {
    if (at.depth >= layout::max_depth) throw Doubt("a BVH is more than 100 levels deep");
    const std::uint64_t tag = at.reference & layout::tag_mask;
    const std::uint64_t address = at.reference & ~layout::tag_mask;
    const bool wide = bvhs_[at.bvh].width == 8;
    if (tag > layout::tag_leaf) {
      read_leaf(address, tag - layout::tag_leaf, at);
    } else if (tag == layout::tag_box) {
      wide ? read_box_node<8>(address, at) : read_box_node<4>(address, at);
    } else if (tag == layout::tag_quantised) {
      bvhs_[at.bvh].quantised = true;
      wide ? read_quantised_node<8>(address, at) : read_quantised_node<4>(address, at);
    } else {
      throw Doubt("a node has the unknown tag " + std::to_string(tag));
    }
  }

  template <int width>
  void read_box_node(std::uint64_t address, const Pending& at) {
    const auto node = read<layout::BoxNode<width>>(memory_, Object::node, address);
    Bounds boxes[width];
    for (int child = 0; child < width; child++) {
      for (int axis = 0; axis < 3; axis++) {
        boxes[child].lower[axis] = node.bounds[axis][0][child];
        boxes[child].upper[axis] = node.bounds[axis][1][child];
      }
    }
    add_children<width>(address, node.children, boxes, at);
  }

  // Embree computes start + scale * number with one rounding on CPUs with FMA and with two on others: the box is around both.
  // Rounding lets it stand out of its parent by a few ulps, and a scale is at least 2 FLT_MIN; what it holds does not stand
  // out, so the parent's box may clip it.
  template <int width>
  void read_quantised_node(std::uint64_t address, const Pending& at) {
    const auto node = read<layout::QuantisedNode<width>>(memory_, Object::node, address);
    const Bounds parent = tree_.bounds(at.node);
    constexpr float rounding = 8 * std::numeric_limits<float>::epsilon();
    constexpr float least = 256 * 2 * std::numeric_limits<float>::min();
    Bounds boxes[width];
    for (int child = 0; child < width; child++) {
      if (node.children[child] == layout::nothing) continue;
      for (int axis = 0; axis < 3; axis++) {
        const float start = node.start[axis];
        const float scale = node.scale[axis];
        const float lower = node.bounds[axis][0][child];
        const float upper = node.bounds[axis][1][child];
        float low = std::min(std::fma(scale, lower, start), scale * lower + start);
        float high = std::max(std::fma(scale, upper, start), scale * upper + start);
        const float slack = rounding * std::max(std::fabs(parent.lower[axis]), std::fabs(parent.upper[axis])) + least;
        if (low < parent.lower[axis] && parent.lower[axis] - low <= slack) low = parent.lower[axis];
        if (high > parent.upper[axis] && high - parent.upper[axis] <= slack) high = parent.upper[axis];
        boxes[child].lower[axis] = low;
        boxes[child].upper[axis] = high;
      }
    }
    add_children<width>(address, node.children, boxes, at);
  }

  // Checks the children's boxes, and lines them up to be followed, first child first.
  template <int width>
  void add_children(std::uint64_t address, const std::uint64_t (&references)[width], const Bounds (&boxes)[width],
                    const Pending& at) {
    const Bounds parent = tree_.bounds(at.node);
    std::uint32_t count = 0;
    int kept[8];  // at most `width`
    for (int child = 0; child < width; child++) {
      if (references[child] == layout::nothing) continue;
      if (!boxes[child].is_proper()) throw Doubt("a node's box is inverted");
      if (!parent.contains(boxes[child])) throw Doubt("a node's box is not inside its parent's");
      kept[count++] = child;
    }
    if (count == 0) throw Doubt("an inner node has no children");
    // Each node leads to a leaf with at least one primitive: more nodes than this only a wrong path can find.
    if (tree_.nodes.size() + count > most_nodes_) {
      throw Doubt("a BVH has more nodes than its primitives need");
    }
    put_in_order(address, kept, count);
    const std::uint32_t first = tree_.make_inner(at.node, count);
    for (std::uint32_t index = count; index-- > 0;) {
      tree_.set_bounds(first + index, boxes[kept[index]]);
      pending_.push_back({references[kept[index]], first + index, at.depth + 1, at.bvh});
    }
  }

  // The slots of a node's children in the order in which they are told.
  void put_in_order(std::uint64_t address, int (&kept)[8], std::uint32_t count) const {
    const std::uint8_t* places = order_ == nullptr ? nullptr : order_->places(address);
    if (places == nullptr) return;
    for (std::uint32_t end = 1; end < count; end++) {
      for (std::uint32_t at = end; at > 0 && places[kept[at]] < places[kept[at - 1]]; at--) {
        std::swap(kept[at], kept[at - 1]);
      }
    }
  }

  void read_leaf(std::uint64_t address, std::uint64_t count, const Pending& at) {
    unsigned char bytes[layout::max_leaf_bytes];
    tree_.make_leaf(at.node);
    if (bvhs_[at.bvh].block == nullptr) {
      memory_.read(Object::leaf, address, bytes, count * layout::instance_bytes);
      for (std::uint64_t index = 0; index < count; index++) {
        std::uint32_t geometry;
        std::memcpy(&geometry, bytes + index * layout::instance_bytes + layout::instance_geometry, sizeof geometry);
        add_instance(geometry, at.node);
      }
      return;
    }
    const Block& block = *bvhs_[at.bvh].block;
    memory_.read(Object::leaf, address, bytes, count * block.bytes);
    for (std::uint64_t index = 0; index < count; index++) {
      std::uint32_t numbers[2][layout::block_lanes];
      std::memcpy(numbers, bytes + index * block.bytes + block.geometry, sizeof numbers);
      for (std::size_t lane = 0; lane < layout::block_lanes; lane++) {
        if (numbers[1][lane] == layout::no_primitive) continue;
        add_face(block, numbers[0][lane], numbers[1][lane], at.node);
        if (lanes_ == nullptr) continue;
        lanes_->see(bvhs_[at.bvh], bytes + index * block.bytes, lane, numbers[0][lane], numbers[1][lane], memory_);
      }
    }
    if (tree_.nodes[at.node].count == leaf_bit) throw Doubt("a leaf is empty");
  }

  // Adds a face of a leaf: one triangle, or the two of a quad. The leaf's box contains them; where spatial splits have
  // clipped it, they overlap.
  void add_face(const Block& block, std::uint32_t geometry, std::uint32_t face, std::uint32_t node) {
    if (geometry >= scene_.parts.size()) throw Doubt("a leaf names a geometry that does not exist");
    const Part& part = scene_.parts[geometry];
    if (part.corners != block.corners) throw Doubt("a leaf names a geometry of another kind");
    if (face >= part.faces) throw Doubt("a leaf names a primitive that does not exist");
    const std::uint32_t triangle = part.first_triangle + part.triangles_per_face() * face;
    if (!kept_[triangle]) throw Doubt("a leaf names a primitive that Embree cannot have kept");
    if (++references_ > most_references_) throw Doubt("the leaves name more primitives than were attached");
    if (seen_[triangle]) {
      if (!scene_.spatial_splits) throw Doubt("a primitive stands in two leaves without spatial splits");
      tree_.splits = true;
    } else {
      seen_[triangle] = true;
      distinct_++;
    }
    // Of a quad that spatial splits have cut, one triangle may lie wholly outside of this leaf: then it is in others.
    const Bounds box = tree_.bounds(node);
    std::uint32_t added = 0;
    for (std::uint32_t half = 0; half < part.triangles_per_face(); half++) {
      const Bounds bounds = part.bounds(face, half);
      if (!box.contains(bounds)) {
        if (!scene_.spatial_splits) throw Doubt("a leaf's box does not contain its primitives");
        tree_.splits = true;
        if (!box.overlaps(bounds)) continue;
      }
      tree_.add_primitive(node, triangle + half);
      added++;
    }
    if (added == 0) throw Doubt("a leaf's box is away from its primitives");
  }

  void add_instance(std::uint32_t geometry, std::uint32_t node) {
    if (geometry >= scene_.parts.size() || !scene_.parts[geometry].instance) {
      throw Doubt("a leaf names an instance that does not exist");
    }
    if (seen_instances_[geometry]) throw Doubt("an instance stands in two leaves");
    seen_instances_[geometry] = true;
    tree_.add_primitive(node, instance_bit | geometry);
  }

  void check_primitives() const {
    if (distinct_ != expected_) {
      throw Doubt("the leaves hold " + std::to_string(distinct_) + " primitives, and " + std::to_string(expected_) +
                  " were attached");
    }
  }

  // "embree 3.13.5 avx2 BVH8<triangle4>", or "… BVH8<triangle4,quad4v>".
  void name_producer() {
    tree_.producer = library_name(version_);
    std::string open;
    for (const LiveBvh& bvh : bvhs_) {
      const std::string structure = (bvh.quantised ? "QBVH" : "BVH") + std::to_string(bvh.width);
      if (open.empty()) {
        tree_.producer += " " + bvh.isa + " " + structure + "<";
      } else {
        tree_.producer += structure == open ? "," : ">," + structure + "<";
      }
      tree_.producer += bvh.block == nullptr ? layout::instance_name : bvh.block->name;
      open = structure;
    }
    if (!open.empty()) tree_.producer += ">";
    // The header of a .bvh has room for 48 bytes; only two structures with long names need more.
    constexpr std::size_t room = 48;
    if (tree_.producer.size() > room) tree_.producer.resize(room);
  }

  const Attached& scene_;
  Memory& memory_;
  std::uint32_t version_;
  Image image_;
  Bounds all_bounds_ = Bounds::empty();  // of all BVHs, also of those that are left out
  std::vector<LiveBvh> bvhs_;
  LaneSink* lanes_ = nullptr;
  const SlotOrder* order_ = nullptr;
  std::vector<Pending> pending_;
  std::vector<bool> kept_;  // by a face's first triangle, as seen_
  std::vector<bool> seen_;
  std::vector<bool> seen_instances_;
  std::uint64_t expected_ = 0;
  std::uint64_t most_references_ = 0;
  std::uint64_t most_nodes_ = 0;
  std::uint64_t references_ = 0;
  std::uint64_t distinct_ = 0;
  Tree tree_;
};

}  // namespace

namespace {

// Reads with the library and memory of this process, or, for tests, with a faulty one.
template <typename Work>
auto with_reader(const Attached& scene, const ShimFault* fault, Work&& work) {
  std::uint32_t version = scene.version;
  Image image = find_image();
  ProcessMemory memory;
  if (fault == nullptr) {
    Reader reader(scene, memory, version, std::move(image));
    return work(reader);
  }
  if (fault->version != 0) version = fault->version;
  if (fault->no_image != 0) image = Image();
  FaultyMemory faulty(memory, *fault);
  Reader reader(scene, faulty, version, std::move(image));
  return work(reader);
}

}  // namespace

Tree read_live_tree(const Attached& scene, const ShimFault* fault) {
  return read_live_scene(scene, fault, nullptr, nullptr).tree;
}

std::vector<LiveBvh> find_live_bvhs(const Attached& scene, const ShimFault* fault) {
  return with_reader(scene, fault, [](Reader& reader) { return reader.find_bvhs(); });
}

LiveScene read_live_scene(const Attached& scene, const ShimFault* fault, LaneSink* lanes, const SlotOrder* order) {
  return with_reader(scene, fault, [&](Reader& reader) {
    reader.show(lanes, order);
    return reader.read_tree(reader.find_bvhs());
  });
}

Tree read_tree_below(const Attached& scene, std::vector<LiveBvh> bvhs, const SlotOrder* order) {
  return with_reader(scene, nullptr, [&](Reader& reader) {
    reader.show(nullptr, order);
    return reader.read_tree(std::move(bvhs)).tree;
  });
}

}  // namespace shim
