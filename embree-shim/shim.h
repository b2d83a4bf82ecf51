/* The whole C ABI between the shim (C++, everything that touches Embree) and the crate: plain structs, no exceptions.
 * bindgen reads this file and nothing else. A function that can fail returns null or non-zero and fills a ShimError.
 * Data flows: ShimPart* -> ShimScene -> ShimIntersector <- ShimQuery; answers come back in ShimHit, and, from a
 * recording intersector, in batches of ShimRecord through a ShimSink. ShimTree carries a tree out. */
#ifndef EMBREE_TRACE_SHIM_H
#define EMBREE_TRACE_SHIM_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What went wrong. `code` is Embree's RTCError (0 = none); `message` is one line, zero terminated. */
typedef struct ShimError {
  int32_t code;
  char message[508];
} ShimError;

enum { SHIM_QUALITY_LOW = 0, SHIM_QUALITY_MEDIUM = 1, SHIM_QUALITY_HIGH = 2 };
enum { SHIM_SCENE_ROBUST = 1, SHIM_SCENE_COMPACT = 2 };
/* What a scene is committed for: once; or again with other vertices, its trees refitted or rebuilt. */
enum { SHIM_COMMIT_ONCE = 0, SHIM_COMMIT_REFIT = 1, SHIM_COMMIT_REBUILD = 2 };

typedef struct ShimSettings {
  const char* device; /* configuration string of rtcNewDevice */
  uint32_t quality;   /* SHIM_QUALITY_* */
  uint32_t flags;     /* SHIM_SCENE_* */
  uint32_t commit;    /* SHIM_COMMIT_*; REFIT ignores the quality */
} ShimSettings;

/* One geometry; part i is geomID i. The arrays are copied. */
typedef struct ShimPart {
  const uint32_t* indices; /* faces * corners vertex indices, all in range */
  uint64_t faces;
  uint32_t corners; /* 3 triangles, 4 quads */
  uint32_t mask;
  uint32_t first_triangle; /* in TRIS; parts share no triangle, and leave none out */
} ShimPart;

typedef struct ShimScene ShimScene;
typedef struct ShimIntersector ShimIntersector;

/* A query: Rust's `embree::Query`, field by field. */
typedef struct ShimQuery {
  float origin[3];
  float tnear;
  float direction[3];
  float tfar;
  float time;
  uint32_t mask;
  uint32_t path;
  uint8_t depth;
  uint8_t purpose;
  uint8_t coherent;
  uint8_t unused;
} ShimQuery;

/* The answer to a closest-hit query that hit: Rust's `embree::Hit`, field by field. */
typedef struct ShimHit {
  float t;
  uint32_t triangle; /* index into TRIS */
  uint32_t part;
  float u;
  float v;
  float normal[3]; /* geometric, not normalised */
} ShimHit;

enum { SHIM_MISS = 0, SHIM_HIT = 1, SHIM_REFUSED = 2 };

/* Rust's `format::rays::Record`, byte for byte (64 bytes). */
typedef struct ShimRecord {
  float origin[3];
  float tnear;
  float direction[3];
  float tfar;
  float time;
  uint32_t mask;
  float t;
  uint32_t triangle;
  float u;
  float v;
  uint32_t path;
  uint8_t kind;
  uint8_t depth;
  uint8_t flags;
  uint8_t purpose;
} ShimRecord;

/* Rust's `tree::Node`, byte for byte (32 bytes). */
typedef struct ShimNode {
  float lower[3];
  uint32_t first;
  float upper[3];
  uint32_t count;
} ShimNode;

/* A tree with everything it needs; made and freed by the shim. */
typedef struct ShimTree {
  const ShimNode* nodes;
  uint64_t node_count;
  const uint32_t* primitives;
  uint64_t primitive_count;
  uint32_t splits;   /* whether a triangle may stand in several leaves */
  char producer[60]; /* zero terminated */
} ShimTree;

/* An element of GEOM: Rust's `format::bvh::Geometry`, byte for byte (32 bytes). */
typedef struct ShimGeometry {
  uint32_t instance; /* 0xFFFFFFFF: not instanced */
  uint32_t geometry; /* geomID */
  uint32_t first_triangle;
  uint32_t triangle_count;
  uint32_t mask;
  uint32_t kind; /* 0 triangles, 1 quads */
  uint32_t flags; /* 1: it moves; 2: instance_mask counts */
  uint32_t instance_mask;
} ShimGeometry;

/* What a `.bvh` holds, borrowed for a call. Nothing in it is believed: every index, box and triangle is checked. */
typedef struct ShimTreeFile {
  const ShimNode* nodes;
  uint64_t node_count;
  const uint32_t* primitives;
  uint64_t primitive_count;
  const float* triangles; /* 9 floats each */
  uint64_t triangle_count;
  const ShimGeometry* geometries;
  uint64_t geometry_count;
  const uint8_t* order; /* ORDR: one per node, or null */
  uint32_t flags;       /* of the header; SHIM_FILE_* */
} ShimTreeFile;

enum { SHIM_FILE_SPLITS = 1, SHIM_FILE_FLATTENED = 2 };

/* What was planted. */
typedef struct ShimPlanted {
  uint32_t number; /* for shim_scene_choose */
  uint32_t trees;  /* one for each of Embree's: triangles, quads */
  uint64_t nodes;
  uint64_t blocks;
  uint64_t bytes;
  uint32_t stack; /* entries that a traversal needs at most */
  uint32_t width; /* of the live nodes */
} ShimPlanted;

/* The objects of Embree's that the live tree is read from. */
enum {
  SHIM_OBJECT_SCENE = 0,
  SHIM_OBJECT_ACCEL_LIST = 1,
  SHIM_OBJECT_ACCEL = 2,
  SHIM_OBJECT_BVH = 3,
  SHIM_OBJECT_VTABLE = 4,
  SHIM_OBJECT_CODE = 5,
  SHIM_OBJECT_TEXT = 6,
  SHIM_OBJECT_NODE = 7,
  SHIM_OBJECT_LEAF = 8,
  SHIM_OBJECT_VERTEX = 9
};

/* For tests of the checks: another version (0 = the true one), no libembree3, children of a planted tree in the order of
 * their slots in place of the file's, or wrong bytes in the nth read of a kind of object: byte = (byte & keep) ^ flip, `length` of them from `offset`. Memory itself is never written. */
typedef struct ShimFault {
  uint32_t version;
  uint32_t no_image;
  uint32_t slots;
  uint32_t object;
  uint32_t offset;
  uint32_t length;
  uint64_t nth;
  uint8_t keep[16];
  uint8_t flip[16];
} ShimFault;

/* Code of a ShimError: a check of the live tree did not hold; the message says which. */
enum { SHIM_DOUBT = 1000 };

/* Takes a batch of the calling thread's records; non-zero stops the recording (the disk is full, say). */
typedef uint32_t (*ShimBatch)(void* user, const ShimRecord* records, uint64_t count);

typedef struct ShimSink {
  ShimBatch batch;
  void* user;
} ShimSink;

/* Records that a batch holds; only the last of an intersector, or one before a flush, is smaller. */
enum { SHIM_BATCH_RECORDS = 1024 };

/* RTC_DEVICE_PROPERTY_VERSION of the library that is linked, such as 31305; 0 when no device can be made. */
uint32_t shim_version(void);

/* Builds and commits a scene; null on failure. */
ShimScene* shim_scene_new(const ShimSettings* settings, const float* vertices, uint64_t vertex_count,
                          const ShimPart* parts, uint32_t part_count, ShimError* error);
void shim_scene_free(ShimScene* scene);
/* Gives a scene that is not committed only once as many other vertices, copied, and commits it. No intersector may be
 * asking meanwhile. Non-zero on failure; after one of Embree's own the scene can only be freed. */
uint32_t shim_scene_update(ShimScene* scene, const float* vertices, uint64_t vertex_count, ShimError* error);
/* lower x y z, upper x y z; +inf and -inf for an empty scene. */
void shim_scene_bounds(const ShimScene* scene, float bounds[6]);
uint64_t shim_scene_triangle_count(const ShimScene* scene);
/* Writes 9 floats a triangle, in the order of TRIS. What Embree drops (a coordinate that is NaN, or of magnitude 1.844e18
 * and more; for a quad: in any of its four vertices) gets NaN in all nine when it would be finite otherwise.
 * Returns how many finite triangles were replaced so. */
uint64_t shim_scene_triangles(const ShimScene* scene, float* triangles);

/* Embree's own tree, read from its memory; `fault` is null but in tests. Null, with SHIM_DOUBT, when a check fails. */
ShimTree* shim_tree_live(const ShimScene* scene, const ShimFault* fault, ShimError* error);
/* Plants a tree: from then on every query traverses it, in memory that belongs to the scene. 0 when it is done. SHIM_DOUBT
 * when anything about the file, the scene or the two together is not as it must be: then nothing has changed.
 * No intersector may be asking meanwhile. `fault` is null but in tests. */
uint32_t shim_scene_plant(ShimScene* scene, const ShimTreeFile* file, const ShimFault* fault, ShimPlanted* planted,
                          ShimError* error);
/* Which tree queries traverse from now on: 0 Embree's own, otherwise the number of a planted one. Intersectors may be asking
 * meanwhile: both trees are valid. Non-zero when there is none of that number; a commit forgets all of them. */
uint32_t shim_scene_choose(ShimScene* scene, uint32_t number);
/* The binary tree of rtcBuildBVH. */
ShimTree* shim_tree_built(const ShimScene* scene, ShimError* error);
void shim_tree_free(ShimTree* tree);

/* An intersector asks `scene`, which must outlive it; it is for one thread at a time. Null on failure. */
ShimIntersector* shim_intersector_new(const ShimScene* scene, ShimError* error);
/* Decorates `inner` and owns it from then on, also on failure. */
ShimIntersector* shim_recording_new(ShimIntersector* inner, ShimSink sink, ShimError* error);
/* Passes on what is not yet, then frees. */
void shim_intersector_free(ShimIntersector* intersector);

/* SHIM_MISS, SHIM_HIT (then *hit is filled) or SHIM_REFUSED. */
uint32_t shim_closest_hit(ShimIntersector* intersector, const ShimQuery* query, ShimHit* hit);
uint32_t shim_occluded(ShimIntersector* intersector, const ShimQuery* query);
/* `width` is 4, 8 or 16: that many queries, hits and outcomes. */
void shim_closest_hits(ShimIntersector* intersector, const ShimQuery* queries, uint32_t width, ShimHit* hits,
                       uint32_t* outcomes);
void shim_occluded_packet(ShimIntersector* intersector, const ShimQuery* queries, uint32_t width, uint32_t* outcomes);
/* Passes an incomplete batch on. Non-zero once the sink has stopped the recording. */
uint32_t shim_flush(ShimIntersector* intersector);
/* Queries refused so far because they would abort Embree. */
uint64_t shim_refused(const ShimIntersector* intersector);

/* A committed scene of the program that this library is linked with, which knows nothing of the shim: held, planted in and
 * recorded. All calls are made by one thread at a time, while nobody asks the scene, and nobody changes or commits it. */
typedef struct ShimHost ShimHost;

/* What such a scene holds, as a .bvh has it; made and freed by the shim. */
typedef struct ShimHostCapture {
  ShimTree tree;
  const float* triangles; /* 9 floats each */
  uint64_t triangle_count;
  const ShimGeometry* geometries;
  uint64_t geometry_count;
  uint32_t version;
  uint32_t planted; /* whether the tree is one that was planted */
} ShimHostCapture;

/* A reject: Rust's `format::rays::Reject`, byte for byte (8 bytes). `record` counts within the batch. */
typedef struct ShimReject {
  uint32_t record;
  uint32_t triangle;
} ShimReject;

/* Takes what a thread asked; threads call at the same time. Non-zero stops the recording. */
typedef uint32_t (*ShimHostBatch)(void* user, uint32_t thread, const ShimRecord* records, uint64_t count,
                                  const ShimReject* rejects, uint64_t reject_count);

typedef struct ShimHostSink {
  ShimHostBatch batch;
  void* user;
} ShimHostSink;

/* What became of a recording, beside what the sink was given. */
typedef struct ShimHostEnd {
  uint64_t threads;
  uint64_t unrecorded;         /* queries for which there was no memory, or of streams that are not understood */
  uint64_t lost_rejects;       /* that could not be assigned, or were too many */
  uint64_t interrupted;        /* closest-hit queries whose interval the program's own functions have changed */
  uint32_t interrupted_scene;  /* whether the scene was committed with a change meanwhile: what was asked then is missing */
} ShimHostEnd;

/* `scene` is any pointer. Null, with SHIM_DOUBT, when it is no scene of libembree3's. */
ShimHost* shim_host_new(const void* scene, ShimError* error);
/* Ends the recording and gives Embree's own trees back. */
void shim_host_free(ShimHost* host);
/* As shim_scene_plant; what was planted before is freed. */
uint32_t shim_host_plant(ShimHost* host, const ShimTreeFile* file, ShimPlanted* planted, ShimError* error);
/* Gives Embree's own trees back. */
uint32_t shim_host_restore(ShimHost* host, ShimError* error);
/* Null, with SHIM_DOUBT, when the scene cannot be read. */
ShimHostCapture* shim_host_capture(const ShimHost* host, ShimError* error);
void shim_host_capture_free(ShimHostCapture* capture);
/* Records what is asked from now on. `capture` is of the scene as it is; it is not needed afterwards. */
uint32_t shim_host_record(ShimHost* host, const ShimHostCapture* capture, ShimHostSink sink, ShimError* error);
/* Ends the recording; no batch comes afterwards. */
void shim_host_end(ShimHost* host, ShimHostEnd* end);
/* What the calling thread asks from now on is of this pixel, depth and purpose. */
void shim_host_label(uint32_t path, uint8_t depth, uint8_t purpose);

#ifdef __cplusplus
}
#endif

#endif
