// Asks the shim by its C ABI (embree-shim/shim.h), and prints what comes back: a triangle in z = 5, a quad in z = 8 that reaches
// further, and rays along z at them, alone and in packets. Linked with a shim and Embree of any version.
#include <cstdio>
#include <initializer_list>

#include "shim.h"

namespace {

// Of the triangle (0, 0), (1, 0), (0, 1), and of the quad (0, 0), (4, 0), (4, 4), (0, 4).
constexpr float vertices[] = {0, 0, 5, 1, 0, 5, 0, 1, 5, 0, 0, 8, 4, 0, 8, 4, 4, 8, 0, 4, 8};
constexpr uint32_t triangle[] = {0, 1, 2};
constexpr uint32_t quad[] = {3, 4, 5, 6};

ShimQuery query(float x, float y, float tfar, uint32_t mask) {
  ShimQuery query{};
  query.origin[0] = x;
  query.origin[1] = y;
  query.direction[2] = 1;
  query.tfar = tfar;
  query.mask = mask;
  return query;
}

// Hits both, the quad's second triangle, nothing, the triangle but too late, the quad as the triangle is masked, nothing.
const ShimQuery queries[] = {
    query(0.25f, 0.5f, 100, ~0u), query(3, 2, 100, ~0u), query(-1, 0, 100, ~0u),
    query(0.25f, 0.5f, 4, ~0u),   query(0.25f, 0.5f, 100, 2), query(0.25f, 0.5f, 100, 4),
};
constexpr unsigned count = sizeof queries / sizeof *queries;

void print(const char* how, uint32_t outcome, const ShimHit& hit, uint32_t occluded) {
  std::printf("%s %u", how, outcome);
  if (outcome == SHIM_HIT) {
    std::printf(" t %g triangle %u part %u u %g v %g normal %g %g %g", hit.t, hit.triangle, hit.part, hit.u, hit.v,
                hit.normal[0] + 0.0f, hit.normal[1] + 0.0f, hit.normal[2]);  // -0 is 0
  }
  std::printf(" occluded %u\n", occluded);
}

int failed(const ShimError& error) {
  std::printf("error %d: %s\n", error.code, error.message);
  return 1;
}

}  // namespace

int main() {
  const ShimSettings settings{"threads=1", SHIM_QUALITY_MEDIUM, SHIM_SCENE_ROBUST, SHIM_COMMIT_ONCE};
  const ShimPart parts[] = {{triangle, 1, 3, 1, 0}, {quad, 1, 4, 3, 1}};
  ShimError error{};
  ShimScene* scene = shim_scene_new(&settings, vertices, 7, parts, 2, &error);
  if (scene == nullptr) return failed(error);
  ShimIntersector* intersector = shim_intersector_new(scene, &error);
  if (intersector == nullptr) return failed(error);

  for (uint8_t coherent : {0, 1}) {
    for (ShimQuery query : queries) {
      query.coherent = coherent;
      ShimHit hit{};
      const uint32_t outcome = shim_closest_hit(intersector, &query, &hit);
      print("one", outcome, hit, shim_occluded(intersector, &query));
    }
  }
  for (uint32_t width : {4u, 8u, 16u}) {
    ShimQuery asked[16];
    for (unsigned lane = 0; lane < width; lane++) asked[lane] = queries[lane % count];
    ShimHit hits[16];
    uint32_t closest[16], occluded[16];
    shim_closest_hits(intersector, asked, width, hits, closest);
    shim_occluded_packet(intersector, asked, width, occluded);
    for (unsigned lane = 0; lane < width; lane++) print("packet", closest[lane], hits[lane], occluded[lane]);
  }
  shim_intersector_free(intersector);

  ShimTree* tree = shim_tree_live(scene, nullptr, &error);
  if (tree == nullptr) {
    std::printf("live tree: error %d: %s\n", error.code, error.message);
  } else {
    std::printf("live tree: %s\n", tree->producer);
    shim_tree_free(tree);
  }
  tree = shim_tree_built(scene, &error);
  if (tree == nullptr) return failed(error);
  std::printf("%s: %u nodes, %u triangles\n", tree->producer, unsigned(tree->node_count), unsigned(tree->primitive_count));
  shim_tree_free(tree);
  shim_scene_free(scene);
}
