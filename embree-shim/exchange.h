/* What the preload library, inside the recorded program, and embree-trace, which started it, share: a mapping with queries
 * and counters, and one file per committed scene; and, where trees are to be planted, a table of them and a list of what became
 * of each scene. Data flows one way, but for `stop` and the table.
 *
 * The mapping: ExchangeHeader; u32 numbers[EXCHANGE_SCENES]; u8 captures[EXCHANGE_CAPTURES]; slots. A thread of the program
 * owns a slot, fills it and marks it full; embree-trace empties it and marks it free. `count` is right at any moment, so what
 * stands in a slot whose owner was killed is not lost. Every field that both sides touch is accessed atomically.
 *
 * An owner holds its slot's lock, a robust mutex of several processes: the kernel says so when it ends with it, however it ends.
 * Then whoever needs a slot marks the abandoned one full in its place. */
#ifndef EMBREE_TRACE_EXCHANGE_H
#define EMBREE_TRACE_EXCHANGE_H

#include <stdint.h>

#include "shim.h"

/* Changes with every change of this file. */
#define EXCHANGE_MAGIC 0x3630684378457445ull

enum {
  EXCHANGE_SLOTS = 256,          /* threads that can record at a time */
  EXCHANGE_RECORDS = 16384,      /* queries of a slot */
  EXCHANGE_REJECTS = 32768,      /* rejects of a slot */
  EXCHANGE_SCENES = 65536,       /* committed scenes that were asked something: the numbers that a chunk has room for */
  EXCHANGE_CAPTURES = 1 << 20,   /* committed scenes */
  EXCHANGE_PATH = 1024
};

/* The depth of a record that a callback of the program asked, while another query was under way; others have none. */
enum { EXCHANGE_NESTED = 0xFE };
/* States of a slot. */
enum { EXCHANGE_FREE = 0, EXCHANGE_OWNED = 1, EXCHANGE_FULL = 2 };
/* States of a capture. */
enum { EXCHANGE_HELD = 1, EXCHANGE_RELEASED = 2 };

typedef struct ExchangeHeader {
  uint64_t magic;
  uint64_t bytes; /* of the whole mapping */
  /* From embree-trace. */
  uint32_t stop; /* non-zero: nothing more is to be recorded */
  int32_t collector; /* its process */
  char directory[EXCHANGE_PATH]; /* of the scenes' files, absolute, zero terminated */
  /* From the program. */
  uint32_t processes; /* that have called Embree */
  uint32_t threads;   /* that have asked Embree */
  uint32_t scenes;    /* numbers given */
  uint32_t captures;  /* scenes committed and captured */
  uint32_t embree_version;
  uint32_t foreign; /* calls of Embree went to a library that is neither libembree3 nor libembree4 */
  uint64_t unrecorded;   /* queries for which there was no slot */
  uint64_t unnumbered;   /* queries of scenes that could not be captured */
  uint64_t lost_rejects; /* rejects that could not be assigned, or were too many */
  uint64_t interrupted;  /* closest-hit queries whose interval the program's own functions have changed */
  uint32_t failed;       /* 1 being written, 2: `failure` says what went wrong first */
  char failure[256];
} ExchangeHeader;

typedef struct ExchangeSlot {
  uint32_t state;
  uint32_t thread; /* numbered from 0, over all processes */
  uint32_t count;  /* complete records */
  uint32_t reject_count;
  uint64_t sequence; /* number, within the thread, of the first record */
  uint64_t lock[5]; /* a pthread_mutex_t: held by the owner */
  ShimRecord records[EXCHANGE_RECORDS];
  uint16_t scenes[EXCHANGE_RECORDS]; /* of each record */
  uint32_t rejects[EXCHANGE_REJECTS][2]; /* index of the record, triangle; those of complete records first */
} ExchangeSlot;

/* A scene's file, NUMBER.scene in the directory: ExchangeScene, parts, nodes, primitives, triangles. The triangles are those
 * of its own geometries, in the order of the parts; an instance's are in the file of the scene that it instances. An entry of
 * the primitives with EXCHANGE_INSTANCE set names an instance by its geomID. */
enum { EXCHANGE_INSTANCE = 0x80000000u };

enum {
  EXCHANGE_TRIANGLES = 0,
  EXCHANGE_QUADS = 1,
  EXCHANGE_INSTANCED = 2,
  EXCHANGE_OTHER = 3 /* curves, points, grids, subdivision surfaces, user geometry: left out */
};

typedef struct ExchangePart {
  uint32_t geometry; /* geomID */
  uint32_t kind;
  uint32_t mask;
  uint32_t first_triangle; /* in TRIS, once flattened */
  uint32_t triangle_count;
  uint32_t capture; /* of the instanced scene */
  uint32_t type;    /* RTCGeometryType */
  uint32_t moving;  /* has several time steps: triangles or transform are those of the first, and no leaf holds it */
  float transform[12]; /* of an instance: 3 x 4, row by row */
} ExchangePart;

typedef struct ExchangeScene {
  uint64_t magic;
  uint64_t part_count;
  uint64_t node_count; /* 0: there is no tree, and `doubt` says why */
  uint64_t primitive_count;
  uint64_t triangle_count; /* in this file */
  uint64_t flattened_count; /* with those of the instances */
  uint32_t scene;  /* which of the program's scenes, from 0 */
  uint32_t commit; /* of this scene, from 0 */
  uint32_t version;
  uint32_t splits;
  uint32_t others;   /* geometries that are left out, also in instances */
  uint32_t dropped;  /* finite triangles that Embree drops, written as NaN */
  char producer[64];
  char doubt[192];
} ExchangeScene;

/* The trees that are to be planted, a file without a name: ExchangeTrees, and `count` of ExchangeTree. */
typedef struct ExchangeTrees {
  uint64_t magic;
  uint64_t count;
  char outcomes[EXCHANGE_PATH]; /* where each ExchangeOutcome is appended, whole */
} ExchangeTrees;

/* A `.bvh` whose checksums are right. Where its arrays start, in bytes; they are read from the file itself. */
typedef struct ExchangeTree {
  char path[EXCHANGE_PATH]; /* absolute, zero terminated */
  uint64_t bytes;           /* of the file, which is another one when it has others, or another number */
  uint64_t inode;
  uint64_t nodes, node_count;
  uint64_t primitives, primitive_count;
  uint64_t triangles, triangle_count;
  uint64_t geometries, geometry_count;
  uint64_t order; /* 0: none */
  uint32_t flags; /* SHIM_FILE_* and others */
  uint32_t unused;
} ExchangeTree;

/* What became of a committed scene. */
enum {
  EXCHANGE_PLANTED = 1,
  EXCHANGE_LEFT = 2,    /* a tree with its geometries was not planted; `reason` says why */
  EXCHANGE_UNKNOWN = 3, /* no tree has its geometries; told once a scene */
  EXCHANGE_CHANGES = 4, /* committed with changes too often; nothing more is planted in it */
  EXCHANGE_FOREIGN = 5  /* the process calls a library that is neither libembree3 nor libembree4 */
};

typedef struct ExchangeOutcome {
  uint32_t process;
  uint32_t scene;   /* of the process's scenes, from 0 */
  uint32_t commit;  /* of those of this scene that changed something, from 0 */
  uint32_t outcome; /* EXCHANGE_* */
  uint64_t tree;    /* of the table */
  double seconds;   /* of the commit that went into it */
  ShimPlanted planted;
  char reason[256];
} ExchangeOutcome;

/* Time in Embree, a file without a name: ExchangeClocks, and EXCHANGE_CLOCKS of ExchangeClock. A thread adds to rows of its
 * own, one for each scene that it asks. */
enum { EXCHANGE_CLOCKS = 65536 };
enum { EXCHANGE_CLOSEST_HIT = 0, EXCHANGE_OCCLUSION = 1 };

typedef struct ExchangeClocks {
  uint64_t magic;
  uint32_t count;  /* rows that were taken; above EXCHANGE_CLOCKS there was none for some */
  uint32_t unused;
  uint64_t unused_too[14];
} ExchangeClocks;

typedef struct ExchangeClock {
  uint32_t process;
  uint32_t scene;    /* of the process's scenes, from 0 */
  uint64_t geometry; /* a hash of its triangles and quads by geomID, kind and count; 0: it has none, or is not known */
  /* By EXCHANGE_CLOSEST_HIT and EXCHANGE_OCCLUSION. */
  uint64_t calls[2];
  uint64_t rays[2];
  uint64_t timed[2];       /* calls whose time was taken */
  uint64_t nanoseconds[2]; /* of all calls, as estimated from those */
  uint64_t unused[6];
} ExchangeClock;

#endif
