// The live trees -> numbers of geometries; an experiment -> where those keep what they have; copies
// of their buffers -> parts; the trees once more, with all checks -> a capture.
#include "host_faces.hpp"

#include <algorithm>
#include <map>
#include <memory>
#include <string>

#include "plant_blocks.hpp"
#include "record.hpp"

namespace shim {
namespace {

using layout::Block;

// Parts are an array by geomID.
constexpr std::uint32_t most_geometries = 1u << 20;
// Indices have 32 bits, of which Embree and the files leave 31.
constexpr std::uint64_t most_triangles = 0x7FFFFFFFu;

template <typename T>
T read(Memory& memory, Object object, std::uintptr_t address) {
  T value;
  memory.read(object, address, &value, sizeof value);
  return value;
}

struct Release {
  void operator()(RTCGeometry geometry) const noexcept { rtcReleaseGeometry(geometry); }
};
using Geometry = std::unique_ptr<RTCGeometryTy, Release>;

// Finds which geometries stand in the leaves: by number, how many corners their faces have.
class Walk {
 public:
  explicit Walk(Memory& memory) : memory_(memory) {}

  void follow(const LiveBvh& bvh) {
    if (bvh.block == nullptr)
      throw Doubt("the scene holds instances: the scenes that they place can be recorded");
    pending_.push_back({bvh.root, 1});
    while (!pending_.empty()) {
      const Pending at = pending_.back();
      pending_.pop_back();
      if (at.depth >= layout::max_depth) throw Doubt("a BVH is more than 100 levels deep");
      const std::uint64_t tag = at.reference & layout::tag_mask;
      const std::uint64_t address = at.reference & ~layout::tag_mask;
      if (tag > layout::tag_leaf) {
        see_leaf(*bvh.block, address, tag - layout::tag_leaf);
      } else if (tag == layout::tag_box || tag == layout::tag_quantised) {
        // Both kinds of nodes start with their children.
        std::uint64_t children[8];
        memory_.read(Object::node, address, children,
                     sizeof children[0] * static_cast<std::size_t>(bvh.width));
        for (int child = 0; child < bvh.width; child++) {
          if (children[child] != layout::nothing)
            pending_.push_back({children[child], at.depth + 1});
        }
      } else if (at.reference != layout::nothing) {
        throw Doubt("a node has the unknown tag " + std::to_string(tag));
      }
      // A true tree over that many triangles has fewer.
      if (++visits_ > 4 * most_triangles) throw Doubt("a BVH has no end");
    }
  }

  const std::map<std::uint32_t, std::uint32_t>& corners() const noexcept { return corners_; }

 private:
  struct Pending {
    std::uint64_t reference;
    std::uint32_t depth;
  };

  void see_leaf(const Block& block, std::uint64_t address, std::uint64_t count) {
    unsigned char bytes[layout::max_leaf_bytes];
    memory_.read(Object::leaf, address, bytes, count * block.bytes);
    for (std::uint64_t index = 0; index < count; index++) {
      std::uint32_t numbers[2][layout::block_lanes];
      std::memcpy(numbers, bytes + index * block.bytes + block.geometry, sizeof numbers);
      for (std::size_t lane = 0; lane < layout::block_lanes; lane++) {
        if (numbers[1][lane] != layout::no_primitive) see(block, numbers[0][lane]);
      }
    }
  }

  void see(const Block& block, std::uint32_t geometry) {
    if (geometry == last_) return;
    last_ = geometry;
    if (geometry >= most_geometries) throw Doubt("a geometry has a number beyond a million");
    const auto found = corners_.emplace(geometry, block.corners).first;
    if (found->second != block.corners) throw Doubt("a geometry stands in trees of two kinds");
  }

  Memory& memory_;
  std::vector<Pending> pending_;
  std::map<std::uint32_t, std::uint32_t> corners_;
  std::uint32_t last_ = most_geometries;
  std::uint64_t visits_ = 0;
};

// A buffer, as an object of Embree's refers to it.
struct View {
  std::uint64_t start;
  std::uint64_t stride;
  std::uint64_t count;
};

// Where the objects of one kind of geometry keep what they have.
struct Places {
  std::size_t mask = 0;
  std::size_t vertices = 0;
  std::size_t indices = 0;
  FilterPlaces filters{};
};

void no_filter(const RTCFilterFunctionNArguments*) {}
void no_other_filter(const RTCFilterFunctionNArguments*) {}

// A geometry of our own, which has what no other word of an object is likely to be.
class Experiment {
 public:
  Experiment(RTCDevice device, bool quads) {
    geometry_.reset(
        rtcNewGeometry(device, quads ? RTC_GEOMETRY_TYPE_QUAD : RTC_GEOMETRY_TYPE_TRIANGLE));
    if (geometry_ == nullptr) throw Doubt("Embree makes no geometry");
    RTCGeometry geometry = geometry_.get();
    const std::size_t corners = quads ? 4 : 3;
    vertices_ = {reinterpret_cast<std::uintptr_t>(coordinates_), 20, 7};
    indices_ = {reinterpret_cast<std::uintptr_t>(corners_), sizeof corners_[0] * corners, 2};
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, coordinates_,
                               0, vertices_.stride, vertices_.count);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                               quads ? RTC_FORMAT_UINT4 : RTC_FORMAT_UINT3, corners_, 0,
                               indices_.stride, indices_.count);
    rtcSetGeometryMask(geometry, mask);
    rtcSetGeometryIntersectFilterFunction(geometry, &no_filter);
    rtcSetGeometryOccludedFilterFunction(geometry, &no_other_filter);
    rtcCommitGeometry(geometry);
  }

  Places find() const {
    // Its object is newer than what others may know of memory.
    ProcessMemory memory;
    Places places;
    places.mask = find(memory, &mask, sizeof mask, 4);
    places.vertices = find(memory, &vertices_, sizeof vertices_, 8);
    places.indices = find(memory, &indices_, sizeof indices_, 8);
    const RTCFilterFunctionN intersect = &no_filter;
    const RTCFilterFunctionN occluded = &no_other_filter;
    places.filters = {find(memory, &intersect, sizeof intersect, 8),
                      find(memory, &occluded, sizeof occluded, 8)};
    return places;
  }

 private:
  // The first offset in the object at which `bytes` stand. Objects are larger than what is searched
  // up to it.
  std::size_t find(Memory& memory, const void* bytes, std::size_t count, std::size_t step) const {
    constexpr std::size_t most = 512;
    unsigned char found[sizeof(View)];
    for (std::size_t offset = 0; offset < most; offset += step) {
      memory.read(Object::vertex, reinterpret_cast<std::uintptr_t>(geometry_.get()) + offset, found,
                  count);
      if (std::memcmp(found, bytes, count) == 0) return offset;
    }
    throw Doubt("a geometry does not keep what it is given where it is searched");
  }

  static constexpr std::uint32_t mask = 0xA5A51234u;

  Geometry geometry_;
  // Room for seven vertices of 20 bytes and, as Embree wants it, 4 bytes behind the last one.
  float coordinates_[36] = {};
  std::uint32_t corners_[8] = {};
  View vertices_{};
  View indices_{};
};

// A geometry's buffers, copied, and the part that they are.
struct Copy {
  std::vector<unsigned char> vertices;
  std::vector<unsigned char> indices;
};

class Faces {
 public:
  Faces(RTCScene scene, RTCDevice device, Memory& memory)
      : scene_(scene), device_(device), memory_(memory) {}

  void add(std::uint32_t id, std::uint32_t corners) {
    const Places& places = corners == 3 ? of(triangles_, false) : of(quads_, true);
    RTCGeometry geometry = rtcGetGeometry(scene_, id);
    if (geometry == nullptr) throw Doubt("a leaf names a geometry that does not exist");
    const auto object = reinterpret_cast<std::uintptr_t>(geometry);
    copies_.emplace_back();
    Copy& copy = copies_.back();
    const std::size_t face_bytes = corners * sizeof(std::uint32_t);
    const View vertices = copy_buffer(geometry, object + places.vertices, RTC_BUFFER_TYPE_VERTEX,
                                      3 * sizeof(float), copy.vertices);
    const View indices = copy_buffer(geometry, object + places.indices, RTC_BUFFER_TYPE_INDEX,
                                     face_bytes, copy.indices);
    if (parts.size() <= id) parts.resize(std::size_t{id} + 1);
    Part& part = parts[id];
    part.vertices = copy.vertices.data();
    part.vertex_stride = vertices.stride;
    part.vertex_count = vertices.count;
    part.indices = copy.indices.data();
    part.index_stride = indices.stride;
    part.faces = indices.count;
    part.corners = corners;
    part.mask = read<std::uint32_t>(memory_, Object::vertex, object + places.mask);
    part.first_triangle = static_cast<std::uint32_t>(triangle_count);
    triangle_count += part.faces * part.triangles_per_face();
    if (triangle_count > most_triangles) throw Doubt("the scene has more than 2^31 triangles");
  }

  std::vector<Part> parts;
  std::uint64_t triangle_count = 0;

 private:
  const Places& of(std::unique_ptr<Places>& places, bool quads) {
    if (places == nullptr) places = std::make_unique<Places>(Experiment(device_, quads).find());
    return *places;
  }

  // What a view at `address` refers to; Embree itself says where it begins.
  View copy_buffer(RTCGeometry geometry, std::uintptr_t address, RTCBufferType type,
                   std::size_t element, std::vector<unsigned char>& into) {
    const auto view = read<View>(memory_, Object::vertex, address);
    const auto start =
        reinterpret_cast<std::uintptr_t>(rtcGetGeometryBufferData(geometry, type, 0));
    constexpr std::uint64_t longest_stride = 1u << 20;
    if (view.start != start || view.count == 0 || view.count > most_triangles ||
        view.stride > longest_stride) {
      throw Doubt("a geometry's buffer is not where it is said to be");
    }
    const std::uint64_t bytes = (view.count - 1) * view.stride + element;
    // Before so much memory is asked for, its end must be there.
    unsigned char last;
    memory_.read(Object::vertex, start + bytes - 1, &last, 1);
    into.resize(bytes);
    memory_.read(Object::vertex, start, into.data(), bytes);
    return view;
  }

  RTCScene scene_;
  RTCDevice device_;
  Memory& memory_;
  std::vector<Copy> copies_;
  std::unique_ptr<Places> triangles_, quads_;
};

// Whether the lanes hold the vertices that the parts have.
class LaneFaces final : public LaneSink {
 public:
  explicit LaneFaces(const Faces& faces) : faces_(faces) {}

  void see(const LiveBvh& bvh, const unsigned char* block, std::size_t lane, std::uint32_t geometry,
           std::uint32_t face, Memory&) override {
    const Part& part = faces_.parts[geometry];
    const layout::Contents contents = bvh.block->contents;
    if (contents == layout::Contents::words) {
      for (std::uint32_t corner = 0; corner < part.corners; corner++) {
        std::uint32_t words;
        std::memcpy(&words, block + (corner * layout::block_lanes + lane) * sizeof words,
                    sizeof words);
        check(sizeof(float) * std::uint64_t{words} ==
              std::uint64_t{part.index(face, corner)} * part.vertex_stride);
      }
      return;
    }
    const LaneFloats expected = lane_floats(part, face, contents);
    for (std::size_t row = 0; row < 3 * part.corners; row++) {
      check(std::memcmp(block + (row * layout::block_lanes + lane) * sizeof(float), &expected[row],
                        sizeof(float)) == 0);
    }
  }

 private:
  static void check(bool holds) {
    if (!holds) throw Doubt("the vertices of the scene's tree are not those of its geometries");
  }

  const Faces& faces_;
};

std::vector<ShimGeometry> rows_of(const std::vector<Part>& parts) {
  std::vector<ShimGeometry> rows;
  for (std::uint32_t id = 0; id < parts.size(); id++) {
    const Part& part = parts[id];
    if (part.faces == 0) continue;
    ShimGeometry row{};
    row.instance = 0xFFFFFFFFu;
    row.geometry = id;
    row.first_triangle = part.first_triangle;
    row.triangle_count = static_cast<std::uint32_t>(part.faces * part.triangles_per_face());
    row.mask = part.mask;
    row.kind = part.corners == 4 ? 1 : 0;
    rows.push_back(row);
  }
  return rows;
}

}  // namespace

HostNumbering::HostNumbering(const std::vector<Part>& parts) : places_(parts.size()) {
  for (std::size_t id = 0; id < parts.size(); id++) {
    places_[id] = {parts[id].first_triangle, static_cast<std::uint32_t>(parts[id].faces),
                   parts[id].corners == 4};
  }
}

asking::Found HostNumbering::triangle(std::uint32_t, std::uint32_t geometry,
                                      std::uint32_t primitive, float u, float v) const noexcept {
  if (geometry >= places_.size() || primitive >= places_[geometry].faces)
    return {no_triangle, false, false};
  const Place& place = places_[geometry];
  // See `place` in embree_intersector.cpp.
  const bool second = place.quads && u + v > 1.0f;
  return {place.first_triangle + (place.quads ? 2 * primitive + (second ? 1 : 0) : primitive),
          second, false};
}

std::vector<std::uint32_t> HostNumbering::geometries() const {
  std::vector<std::uint32_t> found;
  for (std::uint32_t id = 0; id < places_.size(); id++) {
    if (places_[id].faces != 0) found.push_back(id);
  }
  return found;
}

HostCapture capture(const HostScene& scene, const PlantedTree* planted) {
  const Ground ground = scene.ground();
  Attached attached;
  attached.device = ground.device;
  attached.scene = ground.scene;
  attached.version = ground.version;
  attached.bounds[0] = ground.bounds[0];
  attached.bounds[1] = ground.bounds[1];
  // It is not known, and the lanes are looked at all the same.
  attached.spatial_splits = true;
  ProcessMemory memory;
  Walk walk(memory);
  for (const LiveBvh& bvh : find_live_bvhs(attached, nullptr)) walk.follow(bvh);
  RTCDevice device = rtcGetSceneDevice(scene.get());
  const std::unique_ptr<RTCDeviceTy, decltype(&rtcReleaseDevice)> held(device, &rtcReleaseDevice);
  Faces faces(scene.get(), device, memory);
  for (const auto& [id, corners] : walk.corners()) faces.add(id, corners);
  attached.parts = faces.parts;
  attached.triangle_count = faces.triangle_count;
  LaneFaces lanes(faces);
  HostCapture capture{read_live_scene(attached, nullptr, &lanes, planted).tree,
                      {},
                      rows_of(faces.parts),
                      HostNumbering(faces.parts),
                      ground.version};
  capture.triangles.resize(9 * faces.triangle_count);
  float* out = capture.triangles.data();
  for (const Part& part : faces.parts) {
    for (std::uint64_t face = 0; face < part.faces; face++, out += 9 * part.triangles_per_face())
      part.triangles(face, out);
  }
  return capture;
}

FilterPlaces find_filters(RTCDevice device) {
  const FilterPlaces found = Experiment(device, false).find().filters;
  const FilterPlaces of_quads = Experiment(device, true).find().filters;
  if (found.intersect != of_quads.intersect || found.occluded != of_quads.occluded) {
    throw Doubt("geometries keep their filters in different places");
  }
  return found;
}

}  // namespace shim
