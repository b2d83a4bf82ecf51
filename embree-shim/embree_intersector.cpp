// The Intersector that asks Embree: query -> RTCRayHit -> triangle number and barycentrics as the files have them.
#include "embree_intersector.hpp"

#include <vector>

#include "ray_check.hpp"
#include "record.hpp"

namespace shim {
namespace {

// Embree's packet types and calls by width.
template <int width>
struct Packet;

template <>
struct Packet<4> {
  using RayHit = RTCRayHit4;
  using Ray = RTCRay4;
  static constexpr auto intersect = rtcIntersect4;
  static constexpr auto occluded = rtcOccluded4;
};

template <>
struct Packet<8> {
  using RayHit = RTCRayHit8;
  using Ray = RTCRay8;
  static constexpr auto intersect = rtcIntersect8;
  static constexpr auto occluded = rtcOccluded8;
};

template <>
struct Packet<16> {
  using RayHit = RTCRayHit16;
  using Ray = RTCRay16;
  static constexpr auto intersect = rtcIntersect16;
  static constexpr auto occluded = rtcOccluded16;
};

// Embree marks an occluded ray with tfar = -inf. A query that came with it has an empty interval: a miss.
inline Outcome occlusion(float asked_tfar, float tfar) noexcept {
  return tfar == -infinity && asked_tfar != -infinity ? Outcome::hit : Outcome::miss;
}

class EmbreeIntersector final : public Intersector {
 public:
  explicit EmbreeIntersector(const Scene& scene) : scene_(scene.get()) {
    for (const Part& part : scene.parts()) places_.push_back({part.first_triangle, part.corners == 4});
  }

  Outcome closest_hit(const Query& query, Hit& hit) noexcept override {
    if (!is_answerable(query)) return refuse();
    Asked<RTCRayHit, 1> asked;
    load(asked.ray, query);
    asked.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    asked.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    traversal(query.coherent).intersect(scene_, &asked);
    if (asked.hit.geomID == RTC_INVALID_GEOMETRY_ID) return Outcome::miss;
    const RTCHit& found = asked.hit;
    hit.t = asked.ray.tfar;
    hit.normal[0] = found.Ng_x;
    hit.normal[1] = found.Ng_y;
    hit.normal[2] = found.Ng_z;
    place(hit, found.geomID, found.primID, found.u, found.v);
    return Outcome::hit;
  }

  Outcome occluded(const Query& query) noexcept override {
    if (!is_answerable(query)) return refuse();
    RTCRay asked;
    load(asked, query);
    traversal(query.coherent).occluded(scene_, &asked);
    return occlusion(query.tfar, asked.tfar);
  }

  void closest_hits(const Query* queries, Width width, Hit* hits, Outcome* outcomes) noexcept override {
    switch (width) {
      case Width::four: return closest_hits<4>(queries, hits, outcomes);
      case Width::eight: return closest_hits<8>(queries, hits, outcomes);
      case Width::sixteen: return closest_hits<16>(queries, hits, outcomes);
    }
  }

  void occluded_packet(const Query* queries, Width width, Outcome* outcomes) noexcept override {
    switch (width) {
      case Width::four: return occluded_packet<4>(queries, outcomes);
      case Width::eight: return occluded_packet<8>(queries, outcomes);
      case Width::sixteen: return occluded_packet<16>(queries, outcomes);
    }
  }

  std::uint64_t refused() const noexcept override { return refused_; }

 private:
  // Where a geometry's triangles are in TRIS.
  struct Place {
    std::uint32_t first_triangle;
    bool quads;
  };

  Outcome refuse() noexcept {
    refused_++;
    return Outcome::refused;
  }

  Traversal& traversal(bool coherent) noexcept { return coherent ? coherent_ : incoherent_; }

  static void load(RTCRay& ray, const Query& query) noexcept {
    ray.org_x = query.origin[0];
    ray.org_y = query.origin[1];
    ray.org_z = query.origin[2];
    ray.tnear = query.tnear;
    ray.dir_x = query.direction[0];
    ray.dir_y = query.direction[1];
    ray.dir_z = query.direction[2];
    ray.time = query.time;
    ray.tfar = query.tfar;
    ray.mask = query.mask;
    ray.id = 0;
    ray.flags = 0;
  }

  // Fills a packet's rays and which of them Embree may see; returns whether all of those are coherent.
  template <int width>
  bool load(typename Packet<width>::Ray& ray, int (&valid)[width], const Query* queries, Outcome* outcomes) noexcept {
    bool coherent = true;
    for (int lane = 0; lane < width; lane++) {
      const Query& query = queries[lane];
      const bool answerable = is_answerable(query);
      valid[lane] = answerable ? -1 : 0;
      outcomes[lane] = answerable ? Outcome::miss : refuse();
      coherent = coherent && query.coherent != 0;
      ray.org_x[lane] = query.origin[0];
      ray.org_y[lane] = query.origin[1];
      ray.org_z[lane] = query.origin[2];
      ray.tnear[lane] = query.tnear;
      ray.dir_x[lane] = query.direction[0];
      ray.dir_y[lane] = query.direction[1];
      ray.dir_z[lane] = query.direction[2];
      ray.time[lane] = query.time;
      ray.tfar[lane] = query.tfar;
      ray.mask[lane] = query.mask;
      ray.id[lane] = 0;
      ray.flags[lane] = 0;
    }
    return coherent;
  }

  template <int width>
  void closest_hits(const Query* queries, Hit* hits, Outcome* outcomes) noexcept {
    alignas(64) int valid[width];
    Asked<typename Packet<width>::RayHit, width> asked;
    const bool coherent = load<width>(asked.ray, valid, queries, outcomes);
    for (int lane = 0; lane < width; lane++) {
      asked.hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
      asked.hit.instID[0][lane] = RTC_INVALID_GEOMETRY_ID;
    }
    traversal(coherent).template intersect<Packet<width>::intersect>(valid, scene_, &asked);
    for (int lane = 0; lane < width; lane++) {
      if (valid[lane] == 0 || asked.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID) continue;
      outcomes[lane] = Outcome::hit;
      Hit& hit = hits[lane];
      hit.t = asked.ray.tfar[lane];
      hit.normal[0] = asked.hit.Ng_x[lane];
      hit.normal[1] = asked.hit.Ng_y[lane];
      hit.normal[2] = asked.hit.Ng_z[lane];
      place(hit, asked.hit.geomID[lane], asked.hit.primID[lane], asked.hit.u[lane], asked.hit.v[lane]);
    }
  }

  template <int width>
  void occluded_packet(const Query* queries, Outcome* outcomes) noexcept {
    alignas(64) int valid[width];
    typename Packet<width>::Ray asked;
    const bool coherent = load<width>(asked, valid, queries, outcomes);
    traversal(coherent).template occluded<Packet<width>::occluded>(valid, scene_, &asked);
    for (int lane = 0; lane < width; lane++) {
      if (valid[lane] != 0) outcomes[lane] = occlusion(queries[lane].tfar, asked.tfar[lane]);
    }
  }

  // Triangle number and barycentrics. A quad (v0, v1, v2, v3) is hit in its triangle (v0, v1, v3) when u + v <= 1, else in
  // (v2, v3, v1), whose barycentrics Embree has turned into 1 - u and 1 - v.
  void place(Hit& hit, std::uint32_t geometry, std::uint32_t primitive, float u, float v) const noexcept {
    const Place& place = places_[geometry];
    hit.part = geometry;
    const bool second = place.quads && u + v > 1.0f;
    hit.triangle = place.first_triangle + (place.quads ? 2 * primitive + (second ? 1 : 0) : primitive);
    hit.u = second ? 1.0f - u : u;
    hit.v = second ? 1.0f - v : v;
  }

  RTCScene scene_;
  std::vector<Place> places_;
  Traversal incoherent_{false};
  Traversal coherent_{true};
  std::uint64_t refused_ = 0;
};

}  // namespace

std::unique_ptr<Intersector> make_embree_intersector(const Scene& scene) {
  return std::make_unique<EmbreeIntersector>(scene);
}

}  // namespace shim
