// The shim's side of embree_trace/plant.h (host_scene, host_faces, host_recording), without Rust,
// for tools/sanitizers: scenes of which only the handle is known are read, planted in and recorded,
// by threads that come and go, with filters, beside a fork, through commits and releases.
//
//   host CONFIG FLAGS WIDTH    a device configuration, RTCSceneFlags, children of a node
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <mutex>
#include <string>
#include <thread>

#include "host_recording.hpp"
#include "program.hpp"

namespace {

using namespace program;

// Counts what it is given, and stops where it is told to.
struct Sink {
  std::mutex lock;
  std::vector<ShimRecord> records;
  std::uint64_t rejects = 0;
  std::uint64_t most = ~std::uint64_t{0};

  ShimHostSink ends() {
    return {[](void* user, std::uint32_t, const ShimRecord* records, std::uint64_t count,
               const ShimReject* rejects, std::uint64_t reject_count) -> std::uint32_t {
              auto* sink = static_cast<Sink*>(user);
              const std::lock_guard<std::mutex> lock(sink->lock);
              sink->records.insert(sink->records.end(), records, records + count);
              for (std::uint64_t reject = 0; reject < reject_count; reject++)
                CHECK(rejects[reject].record < count);
              sink->rejects += reject_count;
              return sink->records.size() >= sink->most ? 1 : 0;
            },
            this};
  }
};

template <typename Work>
std::string doubt_of(Work&& work) {
  try {
    work();
    return {};
  } catch (const Doubt& doubt) {
    return doubt.what();
  }
}

// What is read of a scene is what the program has made it from.
HostCapture captured(const HostScene& scene, const Program& program, const PlantedTree* planted) {
  HostCapture found = capture(scene, planted);
  const File& file = program.file();
  // By number, as a file has them; the program made them in another order.
  CHECK(found.geometries.size() == file.geometries.size());
  for (const ShimGeometry& row : found.geometries) {
    bool known = false;
    for (const ShimGeometry& made : file.geometries) {
      if (made.geometry != row.geometry) continue;
      known = made.mask == row.mask && made.kind == row.kind &&
              made.triangle_count == row.triangle_count &&
              std::memcmp(file.triangles.data() + 9 * made.first_triangle,
                          found.triangles.data() + 9 * row.first_triangle,
                          36 * std::size_t{row.triangle_count}) == 0;
    }
    CHECK(known);
  }
  return found;
}

void plant_and_read(Program& program, std::uint32_t width) {
  const std::vector<float> own = program.answers();
  File files[2] = {program.file(), program.file()};
  Builder(files[0], width, false).build();
  Builder(files[1], width, true).build();
  RTCScene handle = program.scene();
  auto scene = std::make_unique<HostScene>(handle);
  auto planting = std::make_unique<HostPlanting>(*scene);
  captured(*scene, program, planting->current());
  for (int round = 0; round < 4; round++) {
    const File& file = files[round % 2];
    planting->plant(file.view());
    CHECK(same(program.answers(), own) && planting->current() != nullptr);
    const HostCapture found = captured(*scene, program, planting->current());
    CHECK(found.tree.splits == (round % 2 == 1));
  }
  File broken = files[0];
  broken.nodes[0].count = 99;
  CHECK(!doubt_of([&] { planting->plant(broken.view()); }).empty());
  CHECK(same(program.answers(), own) && planting->current() != nullptr);
  // A commit of a change, with our tree in place, before it and after it.
  program.change();
  rtcCommitScene(handle);
  CHECK(planting->current() == nullptr && same(program.answers(), own));
  CHECK(planting->restore() && !planting->restore());
  planting->plant(files[1].view());
  rtcDetachGeometry(handle, 3);
  CHECK(doubt_of([&] {
          planting->plant(files[0].view());
        }).find("the scene has not been committed") == 0);
  CHECK(planting->restore());
  rtcCommitScene(handle);
  CHECK(doubt_of([&] {
          planting->plant(files[0].view());
        }).find("the scene's own tree is not one of") == 0);
  rtcAttachGeometryByID(handle, program.geometries()[0], 3);
  rtcCommitScene(handle);
  planting->plant(files[0].view());
  CHECK(same(program.answers(), own));
  // The program has gone before what is planted is.
  program.release();
  planting.reset();
  scene.reset();
}

void record(Program& program) {
  const std::vector<float> own = program.answers();
  const std::uint64_t each = 2 * own.size();
  const HostScene scene(program.scene());
  Sink sink;
  {
    HostRecording recording(scene, captured(scene, program, nullptr).numbering, sink.ends());
    for (int round = 0; round < 3; round++) {
      std::vector<std::thread> threads;
      for (std::uint32_t thread = 0; thread < 4; thread++) {
        threads.emplace_back([&, thread] {
          label(thread, 1, 2);
          CHECK(same(program.answers(), own));
        });
      }
      for (std::thread& thread : threads) thread.join();
    }
    const pid_t child = fork();
    if (child == 0) {
      const bool good = same(program.answers(), own);
      recording.end();
      _exit(good && same(program.answers(), own) && sink.records.size() <= 12 * each ? 0 : 1);
    }
    int status = 1;
    CHECK(waitpid(child, &status, 0) == child && status == 0);
    const ShimHostEnd end = recording.end();
    CHECK(end.threads >= 1 && end.threads <= 4 && end.unrecorded == 0 &&
          end.interrupted_scene == 0 && end.lost_rejects == 0);
    CHECK(sink.records.size() == 12 * each && sink.rejects > 0);
    CHECK(same(program.answers(), own) && sink.records.size() == 12 * each);
  }
  std::uint64_t hits = 0;
  for (const ShimRecord& record : sink.records) {
    CHECK(record.path < 4 && record.depth == 1 && record.purpose == 2);
    hits += record.flags & 1;
  }
  CHECK(hits == 12 * 2 *
                    static_cast<std::uint64_t>(
                        std::count_if(own.begin(), own.end(), [](float t) { return t >= 0; })));

  // A sink that stops, and a commit meanwhile.
  Sink full;
  full.most = 1;
  {
    HostRecording recording(scene, captured(scene, program, nullptr).numbering, full.ends());
    for (int round = 0; round < 4; round++) CHECK(same(program.answers(), own));
    program.change();
    rtcCommitScene(program.scene());
    CHECK(same(program.answers(), own));
    CHECK(recording.end().interrupted_scene == 1 && full.records.size() == SHIM_BATCH_RECORDS);
  }
  CHECK(same(program.answers(), own));
}

// Streams, of which Embree makes packets of its own. The sink must be given as many queries, and as
// many that hit.
void streams(Program& program) {
  const HostScene scene(program.scene());
  Sink sink;
  HostRecording recording(scene, captured(scene, program, nullptr).numbering, sink.ends());
  std::uint64_t asked = 0;
  std::uint64_t hits = 0;
  for (const RTCIntersectContextFlags flags :
       {RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT, RTC_INTERSECT_CONTEXT_FLAG_COHERENT}) {
    for (std::size_t count = 1; count <= program.rays().size(); count += 97) {
      RTCIntersectContext context;
      rtcInitIntersectContext(&context);
      context.flags = flags;
      std::vector<RTCRayHit> closest(program.rays().begin(),
                                     program.rays().begin() + static_cast<std::ptrdiff_t>(count));
      std::vector<RTCRay> any;
      for (const RTCRayHit& ray : closest) any.push_back(ray.ray);
      rtcIntersect1M(program.scene(), &context, closest.data(), static_cast<unsigned>(count),
                     sizeof closest[0]);
      rtcOccluded1M(program.scene(), &context, any.data(), static_cast<unsigned>(count),
                    sizeof any[0]);
      asked += 2 * count;
      for (const RTCRayHit& ray : closest)
        hits += ray.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
      for (const RTCRay& ray : any) hits += ray.tfar < 0 ? 1 : 0;
    }
  }
  CHECK(recording.end().unrecorded == 0 && sink.records.size() == asked);
  for (const ShimRecord& record : sink.records) hits -= record.flags & 1;
  CHECK(hits == 0);
}

// Scenes and devices of several threads, recorded and planted in at once.
void threads(const char* config, int flags, std::uint32_t width) {
  std::vector<std::thread> threads;
  for (std::uint64_t seed = 0; seed < 4; seed++) {
    threads.emplace_back([=] {
      Program program(config, flags, 80, seed);
      const std::vector<float> own = program.answers();
      File file = program.file();
      Builder(file, width, seed % 2 == 0).build();
      const HostScene scene(program.scene());
      HostPlanting planting(scene);
      for (int round = 0; round < 3; round++) {
        planting.plant(file.view());
        Sink sink;
        HostRecording recording(scene, capture(scene, planting.current()).numbering, sink.ends());
        CHECK(same(program.answers(), own));
        planting.restore();
        recording.end();
        CHECK(sink.records.size() == 2 * own.size());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

// Handles that are none: every word of an object of Embree's, and addresses of all kinds.
void handles(const Program& program) {
  const auto refused = [](const void* handle) {
    return !doubt_of([&] { HostScene scene(handle); }).empty();
  };
  CHECK(refused(nullptr) && refused(&program) && refused(program.device()) &&
        refused(program.geometries()[0]));
#ifndef __SANITIZE_THREAD__
  // ThreadSanitizer has memory of its own that it cannot be shown.
  for (std::uintptr_t address = 1; address != 0; address <<= 1) {
    CHECK(refused(reinterpret_cast<const void*>(address)) &&
          refused(reinterpret_cast<const void*>(~address)));
  }
#endif
  for (std::size_t offset = 8; offset < 88; offset += 8) {
    CHECK(refused(reinterpret_cast<const char*>(program.scene()) + offset));
  }
}

}  // namespace

int main(int count, char** words) {
  if (count != 4) return 2;
  const char* config = words[1];
  const int flags = std::atoi(words[2]);
  const auto width = static_cast<std::uint32_t>(std::atoi(words[3]));
  Program program(config, flags, 200, 1);
  if (!program.is_there()) {
    std::printf("this processor has no %s\n", config);
    return 0;
  }
  handles(program);
  record(program);
  streams(program);
  plant_and_read(program, width);
  threads(config, flags, width);
  std::printf("scenes read, planted in and recorded\n");
  return 0;
}
