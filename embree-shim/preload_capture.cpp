// A committed scene -> its file (exchange.h): the parts, the tree that Embree built, read from its memory, and the triangles.
// Instanced scenes are named, not copied: embree-trace puts them together.
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "live_bvh.hpp"
#include "preload_exchange.hpp"
#include "preload_facts.hpp"
#include "preload_scenes.hpp"
#include "record.hpp"
#include "tree.hpp"

namespace preload {
namespace {

// Indices have 32 bits, of which Embree and the files leave 31.
constexpr std::uint64_t most_triangles = 0x7FFFFFFFu;

struct CannotWrite {
  int error;
};

// A file that gets its name once it is whole.
class Output {
 public:
  explicit Output(std::string path) : path_(std::move(path)), file_(std::fopen((path_ + ".part").c_str(), "we")) {
    if (file_ == nullptr) throw CannotWrite{errno};
    std::setvbuf(file_, nullptr, _IOFBF, 1 << 20);
  }
  ~Output() {
    if (file_ == nullptr) return;
    std::fclose(file_);
    std::remove((path_ + ".part").c_str());
  }
  Output(const Output&) = delete;
  Output& operator=(const Output&) = delete;

  template <typename T>
  void write(const T* data, std::size_t count) {
    if (std::fwrite(data, sizeof(T), count, file_) != count) throw CannotWrite{errno};
  }

  void commit() {
    std::FILE* file = file_;
    file_ = nullptr;
    if (std::fclose(file) != 0 || std::rename((path_ + ".part").c_str(), path_.c_str()) != 0) {
      const int error = errno;
      std::remove((path_ + ".part").c_str());
      throw CannotWrite{error};
    }
  }

 private:
  std::string path_;
  std::FILE* file_;
};

}  // namespace

// Builds one capture.
class Writer {
 public:
  Writer(const Scene& scene, std::uint32_t index) : scene_(scene), capture_(std::make_shared<Capture>(index)) {}

  std::shared_ptr<const Capture> write(const std::vector<Attachment>& attachments) {
    for (const Attachment& attachment : attachments) place(attachment);
    if (capture_->flattened_ > most_triangles) {
      fail("a scene has more than 2^31 triangles once its instances are flattened");
      return nullptr;
    }
    describe();
    ExchangeScene header{};
    shim::Tree tree;
    try {
      const shim::PlantedTree* planted = scene_.planting.current();
      if (planted != nullptr && planted->splits()) attached_.spatial_splits = true;
      tree = shim::read_live_scene(attached_, nullptr, nullptr, planted).tree;
    } catch (const shim::Doubt& doubt) {
      tree = shim::Tree();
      std::snprintf(header.doubt, sizeof header.doubt, "%s", doubt.what());
    }
    header.magic = EXCHANGE_MAGIC;
    header.part_count = parts_.size();
    header.node_count = tree.nodes.size();
    header.primitive_count = tree.primitives.size();
    header.triangle_count = own_triangles_;
    header.flattened_count = capture_->flattened_;
    header.scene = scene_.index;
    header.commit = scene_.commits;
    header.version = attached_.version;
    header.splits = tree.splits ? 1 : 0;
    header.others = capture_->others_;
    std::snprintf(header.producer, sizeof header.producer, "%s", tree.producer.c_str());

    const std::string path = std::string(exchange_directory()) + "/" + std::to_string(capture_->index()) + ".scene";
    Output file(path);
    file.write(&header, 1);
    file.write(parts_.data(), parts_.size());
    file.write(tree.nodes.data(), tree.nodes.size());
    file.write(tree.primitives.data(), tree.primitives.size());
    for (const shim::Part& part : faces_) {
      float triangles[18];
      for (std::uint64_t face = 0; face < part.faces; face++) {
        part.triangles(face, triangles);
        file.write(triangles, 9 * part.triangles_per_face());
      }
    }
    file.commit();
    return capture_;
  }

 private:
  static const char* exchange_directory() noexcept {
    const ExchangeHeader* header = exchange();
    return header == nullptr ? "" : header->directory;
  }

  // Gives a geometry its place in TRIS.
  void place(const Attachment& attachment) {
    const Geometry& geometry = attachment.state;
    const unsigned id = attachment.id;
    ExchangePart part{};
    part.geometry = id;
    part.type = geometry.type;
    part.mask = geometry.mask;
    part.first_triangle = static_cast<std::uint32_t>(capture_->flattened_);
    part.kind = EXCHANGE_OTHER;
    if (attached_.parts.size() <= id) attached_.parts.resize(std::size_t{id} + 1);
    shim::Part& here = attached_.parts[id];
    here.first_triangle = part.first_triangle;
    here.mask = geometry.mask;
    const bool moves = geometry.time_steps > 1;
    std::uint64_t primitives = 0;
    const bool quads = geometry.type == RTC_GEOMETRY_TYPE_QUAD;
    if (quads || geometry.type == RTC_GEOMETRY_TYPE_TRIANGLE) {
      part.kind = quads ? EXCHANGE_QUADS : EXCHANGE_TRIANGLES;
      shim::Part faces = here;
      add_faces(geometry, faces);
      primitives = faces.faces;
      part.triangle_count = static_cast<std::uint32_t>(primitives * faces.triangles_per_face());
      own_triangles_ += part.triangle_count;
      faces_.push_back(faces);
      // What moves stands in trees of its own, which are not read.
      if (!moves) here = faces;
    } else if (geometry.type == RTC_GEOMETRY_TYPE_INSTANCE && attachment.instanced != nullptr) {
      const Capture& child = *attachment.instanced;
      part.kind = EXCHANGE_INSTANCED;
      part.capture = child.index();
      part.triangle_count = static_cast<std::uint32_t>(child.flattened_);
      real().rtcGetGeometryTransform(geometry.handle, 0.0f, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, part.transform);
      here.instance = !moves;
      capture_->others_ += child.others_;
      capture_->moving_ = capture_->moving_ || child.moving_;
      capture_->children_.push_back(attachment.instanced);
    } else if (geometry.type != RTC_GEOMETRY_TYPE_INSTANCE) {
      capture_->others_++;
    }
    part.moving = moves ? 1 : 0;
    capture_->moving_ = capture_->moving_ || moves;
    auto& places = capture_->places_;
    if (places.size() <= id) places.resize(std::size_t{id} + 1);
    places[id].kind = part.kind;
    places[id].moves = moves;
    places[id].first_triangle = part.first_triangle;
    places[id].primitives = static_cast<std::uint32_t>(primitives);
    if (part.kind == EXCHANGE_INSTANCED) places[id].instanced = attachment.instanced.get();
    capture_->flattened_ += part.triangle_count;
    parts_.push_back(part);
  }

  static void add_faces(const Geometry& geometry, shim::Part& part) noexcept {
    part.corners = geometry.type == RTC_GEOMETRY_TYPE_QUAD ? 4 : 3;
    if (!geometry.vertices.set || !geometry.indices.set) return;
    const auto data = [&](RTCBufferType type) {
      return static_cast<const unsigned char*>(real().rtcGetGeometryBufferData(geometry.handle, type, 0));
    };
    part.vertices = data(RTC_BUFFER_TYPE_VERTEX);
    part.vertex_stride = geometry.vertices.stride;
    part.vertex_count = geometry.vertices.count;
    part.indices = data(RTC_BUFFER_TYPE_INDEX);
    part.index_stride = geometry.indices.stride;
    if (part.vertices != nullptr && part.indices != nullptr) part.faces = geometry.indices.count;
  }

  // What Embree says of the committed scene.
  void describe() noexcept {
    ask_embree(scene_.handle, attached_);
    attached_.spatial_splits = scene_.spatial_splits;
    attached_.others = capture_->is_undecided();
    attached_.triangle_count = capture_->flattened_;
    if (ExchangeHeader* header = exchange()) store(header->embree_version, attached_.version);
  }

  const Scene& scene_;
  std::shared_ptr<Capture> capture_;
  shim::Attached attached_;
  std::vector<ExchangePart> parts_;
  std::vector<shim::Part> faces_;  // of triangles and quads, also of those that move
  std::uint64_t own_triangles_ = 0;
};

std::shared_ptr<const Capture> write_capture(const Scene& scene, const std::vector<Attachment>& attachments) {
  ExchangeHeader* header = exchange();
  if (header == nullptr) return nullptr;
  const std::uint32_t index = add(header->captures, 1u);
  if (index >= EXCHANGE_CAPTURES) {
    fail("the program commits scenes too often: more than a million times");
    return nullptr;
  }
  set_capture_state(index, EXCHANGE_HELD);
  try {
    return Writer(scene, index).write(attachments);
  } catch (const CannotWrite& problem) {
    fail((std::string("a scene cannot be written: ") + std::strerror(problem.error)).c_str());
  } catch (const std::exception& problem) {
    fail(problem.what());
  }
  return nullptr;
}

Capture::~Capture() { set_capture_state(index_, EXCHANGE_RELEASED); }

std::uint32_t Capture::number() const noexcept {
  std::call_once(numbered_, [this] { number_ = number_scene(index_); });
  return number_;
}

Capture::Found Capture::triangle(std::uint32_t instance, std::uint32_t geometry, std::uint32_t primitive, float u,
                                 float v) const noexcept {
  constexpr Found none{shim::no_triangle, false, false};
  const Capture* capture = this;
  std::uint32_t first = 0;
  bool moves = false;
  if (instance != RTC_INVALID_GEOMETRY_ID) {
    if (instance >= places_.size() || places_[instance].instanced == nullptr) return none;
    capture = places_[instance].instanced;
    first = places_[instance].first_triangle;
    moves = places_[instance].moves;
  }
  if (geometry >= capture->places_.size()) return none;
  const Place& place = capture->places_[geometry];
  if (primitive >= place.primitives) return none;
  // See `place` in embree_intersector.cpp.
  const bool quad = place.kind == EXCHANGE_QUADS;
  const bool second = quad && u + v > 1.0f;
  const std::uint32_t triangle = first + place.first_triangle + (quad ? 2 * primitive + (second ? 1 : 0) : primitive);
  return {triangle, second, moves || place.moves};
}

}  // namespace preload
