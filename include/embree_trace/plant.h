/* embree-trace from C and C++, for renderers that call it themselves: a tree of a .bvh file in
 * place of Embree's own in a committed scene, and the queries that the renderer asks of a scene,
 * with Embree's answers, in a .rays file.
 *
 *     et_record_begin(scene, "casts.rays", "built.bvh", 0);   records, while the renderer renders,
 *     et_record_end(scene, NULL);                             what it asks by Embree's own calls
 *     bvh-build built.bvh ours.bvh --rays casts.rays          makes a better tree (a command)
 *     et_plant(scene, "ours.bvh", NULL);                      Embree's kernels traverse it
 *     et_unplant(scene);                                      Embree's own tree again
 *
 * Embree. Both work in scenes of Embree 3.13.5 (Debian 12's libembree3); a scene of any other
 * version is refused. The library uses the libembree3 of the program. What is checked before
 * anything is changed is in docs/planting.md.
 *
 * Errors. A function that can fail returns ET_OK or another ET_ code, and then
 * et_error_message() is one line that says what, where, and what became of it; nothing has
 * changed, unless it says so. No C++ exception and no Rust panic leaves a function.
 *
 * Scenes. A scene handle may be anything but one that was released: null, and what is no scene
 * of this process's Embree, is an error. While a tree is planted in a scene, or it is recorded,
 * the library holds a reference to it (rtcRetainScene): releasing it does no harm, and
 * et_unplant and et_record_end free it.
 *
 * Threads. Functions may be called from any thread; they wait for one another. While one of them
 * works on a scene, no thread may ask that scene, change it or commit it; other scenes are not
 * concerned. From a filter or another callback of Embree's only et_record_label may be called.
 *
 * Commits. Call et_unplant before a scene is committed with a change, and et_plant after it,
 * with a tree of what it has become. After a commit without et_unplant Embree may traverse its
 * own new tree: nothing breaks, and et_plant plants anew.
 *
 * fork. A child may go on asking a scene that is planted in or recorded. What it asks is not
 * recorded. Do not fork while another thread is in one of these functions.
 *
 * The library cannot be unloaded: dlclose leaves it where it is. */
#ifndef EMBREE_TRACE_PLANT_H
#define EMBREE_TRACE_PLANT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Of <embree3/rtcore.h>, which is not included here. */
typedef struct RTCSceneTy* RTCScene;

/* Grows with every change of this header that a program could notice. */
#define ET_API_VERSION 1

enum {
  ET_OK = 0,
  ET_ERROR_ARGUMENT = 1, /* a null pointer, an unknown flag, or what is no scene */
  ET_ERROR_FILE = 2,     /* that cannot be read or written, or bytes that are no whole .bvh */
  ET_ERROR_REFUSED = 3,  /* a tree of another scene, or a scene that cannot be worked on */
  ET_ERROR_STATE = 4,    /* nothing is planted or recorded, it is already, or a commit cut it */
  ET_ERROR_MEMORY = 5,
  ET_ERROR_INTERNAL = 6  /* a defect of the library's */
};

/* ET_API_VERSION, as the library was built with. */
uint32_t et_api_version(void);
/* Of the library, such as "0.1.0". */
const char* et_version(void);
/* What the calling thread's last call that failed said: one line, empty when none has. Good
 * until its next call that fails. */
const char* et_error_message(void);

/* A tree that was planted. */
typedef struct EtPlanted {
  uint32_t trees; /* of Embree's that it stands in for: one of triangles, one of quads, or both */
  uint32_t width; /* children that a node has room for */
  uint32_t stack; /* entries that a traversal needs at most */
  uint32_t unused;
  uint64_t nodes;
  uint64_t blocks; /* of up to four triangles or quads */
  uint64_t bytes;  /* of memory */
} EtPlanted;

/* Puts the tree of a .bvh file in place of Embree's own, or of the one that was planted before.
 * The file is read and checked as a whole, and not needed afterwards. `planted` may be null.
 * ET_ERROR_ARGUMENT, ET_ERROR_FILE, ET_ERROR_REFUSED: the scene keeps the tree that it has. */
int et_plant(RTCScene scene, const char* path, EtPlanted* planted);
/* The same for a .bvh in memory, at any address. */
int et_plant_memory(RTCScene scene, const void* data, size_t size, EtPlanted* planted);
/* Gives Embree's own tree back and frees what was planted. ET_ERROR_STATE: nothing is. */
int et_unplant(RTCScene scene);

/* For et_record_begin. */
enum {
  ET_RECORD_COMPRESSED = 1 /* two to four times smaller, for processor time of another thread */
};

/* Writes the tree that a scene's queries traverse to `bvh`, and from then on every query of the
 * scene, with its answer and the candidates that filters refused, to `rays`. It does not matter
 * how the renderer asks: by rtcIntersect1, rtcOccluded1, their packets, or streams; it goes on
 * calling Embree, whose table of kernels in the scene leads through the library meanwhile.
 *
 * A scene may hold triangles and quads that stand still. Of a scene that instances place, what
 * they ask is recorded, in the scene's own space; of one that holds instances, nothing can be. A
 * commit with a change ends the recording early. Up to 16 scenes are recorded at a time. Where a
 * device has no kernel of a packet's width, Embree 3.13.5 asks lanes that are off, too, and
 * those are recorded.
 *
 * What is written at any moment can be read: a killed program loses at most the last 65,536
 * queries of each thread. */
int et_record_begin(RTCScene scene, const char* rays, const char* bvh, uint32_t flags);

/* Numbers of a recording. */
typedef struct EtRecorded {
  uint64_t queries;
  uint64_t rejects; /* candidates that filters refused */
  uint64_t bytes;   /* of the .rays */
  uint64_t threads; /* that asked; one that began after another had ended counts as that one */
  uint64_t unrecorded;   /* queries that were answered and are not in the file */
  uint64_t lost_rejects; /* rejects that are not in the file: too many of one query */
  uint64_t interrupted;  /* queries that the renderer's own filters have ended */
} EtRecorded;

/* Ends a recording and completes its file. `recorded` may be null; it is filled also on
 * ET_ERROR_STATE.
 * ET_ERROR_STATE: nothing is recorded; or the scene was committed with a change meanwhile, and
 * what was asked since is missing.
 * ET_ERROR_FILE: the file could not be written to its end; what there is can be read. */
int et_record_end(RTCScene scene, EtRecorded* recorded);

/* Purposes of queries. */
enum {
  ET_PURPOSE_UNKNOWN = 0,
  ET_PURPOSE_CAMERA = 1,
  ET_PURPOSE_SHADOW = 2,
  ET_PURPOSE_AMBIENT_OCCLUSION = 3,
  ET_PURPOSE_DIFFUSE = 4,
  ET_PURPOSE_SPECULAR = 5
};
#define ET_NO_PATH 0xFFFFFFFFu
#define ET_NO_DEPTH 0xFFu

/* What the calling thread asks from now on is of the path from this pixel (y * width + x), of
 * this depth (0: camera rays, 1: the first bounce and its shadow rays) and purpose. Embree is
 * told none of that, and reports by pixel, depth and purpose need it. Until the first call a
 * thread's queries are of ET_NO_PATH, ET_NO_DEPTH and ET_PURPOSE_UNKNOWN. */
void et_record_label(uint32_t path, uint8_t depth, uint8_t purpose);

#ifdef __cplusplus
}
#endif

#endif
