// Planting as a program does it that only has Embree's API, for tests/embree_planting.rs and, under
// sanitizers, for tools/sanitizers: scenes with masks, filters, odd strides and other geometry;
// commits with and without a change, joined by threads, refitted; scenes that are released while
// planted; roots that change while others ask; fork; and files with any word changed. Whatever is
// planted, the answers must be those of Embree's own tree.
//
//   planting CONFIG FLAGS WIDTH ROUNDS    a device configuration, RTCSceneFlags, children of a node,
//                                         files to damage
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <memory>
#include <string>
#include <thread>

#include "program.hpp"

namespace {

using namespace program;

// Why a file is refused; empty when it is planted.
std::string refusal(const Program& program, const File& file, std::unique_ptr<PlantedTree>& planted) {
  try {
    planted = plant(program.ground(), file.view(), nullptr);
    return {};
  } catch (const Doubt& doubt) {
    return doubt.what();
  }
}

// Commits of every kind while a tree is planted.
void commits(const char* config, int flags, std::uint32_t width) {
  Program program(config, flags, 300, 1);
  const std::vector<float> own = program.answers();
  File files[2] = {program.file(), program.file()};
  Builder(files[0], width, false).build();
  Builder(files[1], width, true).build();
  CHECK(files[1].primitives.size() > files[0].primitives.size());
  std::unique_ptr<PlantedTree> planted;
  const auto plant_both = [&] {
    for (const File& file : files) {
      const std::string why = refusal(program, file, planted);
      if (!why.empty()) std::fprintf(stderr, "refused: %s\n", why.c_str());
      CHECK(why.empty() && same(program.answers(), own));
      // The next one is planted where Embree's own stands.
      if (&file == files) planted->restore();
    }
  };
  plant_both();

  CHECK(planted->is_current(program.ground()));
  rtcCommitScene(program.scene());
  CHECK(planted->is_current(program.ground()) && same(program.answers(), own));
  program.change();
  rtcCommitScene(program.scene());
  CHECK(!planted->is_current(program.ground()) && same(program.answers(), own));
  plant_both();

  // Geometry that goes away, comes back, and is none of the file's.
  rtcDisableGeometry(program.geometries()[0]);
  rtcCommitScene(program.scene());
  planted.reset();
  const std::string less = refusal(program, files[0], planted);
  CHECK(less.find("the scene's own tree is not one of the file's triangles") == 0);
  rtcEnableGeometry(program.geometries()[0]);
  RTCGeometry user = rtcNewGeometry(program.device(), RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(user, 1);
  rtcSetGeometryBoundsFunction(user, box_of_user_geometry, nullptr);
  rtcSetGeometryIntersectFunction(user, [](const RTCIntersectFunctionNArguments*) {});
  rtcSetGeometryOccludedFunction(user, [](const RTCOccludedFunctionNArguments*) {});
  rtcCommitGeometry(user);
  const unsigned id = rtcAttachGeometry(program.scene(), user);
  rtcReleaseGeometry(user);
  rtcCommitScene(program.scene());
  plant_both();
  rtcDetachGeometry(program.scene(), id);
  rtcCommitScene(program.scene());

  // Embree's own refit does not run over a tree of ours.
  for (const RTCBuildQuality quality :
       {RTC_BUILD_QUALITY_HIGH, RTC_BUILD_QUALITY_MEDIUM, RTC_BUILD_QUALITY_LOW, RTC_BUILD_QUALITY_REFIT}) {
    rtcSetSceneBuildQuality(program.scene(),
                            quality == RTC_BUILD_QUALITY_REFIT ? RTC_BUILD_QUALITY_LOW : quality);
    for (RTCGeometry geometry : program.geometries()) rtcSetGeometryBuildQuality(geometry, quality);
    for (int round = 0; round < 3; round++) {
      program.change();
      rtcCommitScene(program.scene());
      CHECK(same(program.answers(), own));
      plant_both();
    }
  }
  program.change();
  std::vector<std::thread> threads;
  for (int thread = 0; thread < 3; thread++) {
    threads.emplace_back([&] { rtcJoinCommitScene(program.scene()); });
  }
  for (std::thread& thread : threads) thread.join();
  plant_both();
  program.release();
  planted.reset();
}

// Scenes and devices of several threads, roots that change while others ask, a fork, and an end in
// any order.
void threads(const char* config, int flags, std::uint32_t width) {
  std::vector<std::thread> threads;
  for (std::uint64_t seed = 0; seed < 4; seed++) {
    threads.emplace_back([=] {
      Program program(config, flags, 80, seed);
      const std::vector<float> own = program.answers();
      File file = program.file();
      Builder(file, width, seed % 2 == 0).build();
      for (int round = 0; round < 3; round++) {
        std::unique_ptr<PlantedTree> planted;
        CHECK(refusal(program, file, planted).empty() && same(program.answers(), own));
        program.change();
        rtcCommitScene(program.scene());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  threads.clear();

  Program program(config, flags, 200, 9);
  const std::vector<float> own = program.answers();
  File file = program.file();
  Builder(file, width, true).build();
  std::unique_ptr<PlantedTree> planted;
  CHECK(refusal(program, file, planted).empty());
  std::atomic<int> asking{3};
  for (int thread = 0; thread < 3; thread++) {
    threads.emplace_back([&] {
      for (int round = 0; round < 3; round++) CHECK(same(program.answers(), own));
      asking--;
    });
  }
  while (asking > 0) {
    planted->restore();
    planted->make_current();
  }
  for (std::thread& thread : threads) thread.join();
  const pid_t child = fork();
  if (child == 0) {
    const bool good = same(program.answers(), own);
    planted->restore();
    planted.reset();
    _exit(good && same(program.answers(), own) ? 0 : 1);
  }
  int status = 1;
  CHECK(waitpid(child, &status, 0) == child && status == 0);
  CHECK(same(program.answers(), own));
}

// Words of files, changed at random, and arrays cut off.
void damage(const char* config, int flags, std::uint32_t width, int rounds) {
  Program program(config, flags, 60, 3);
  const std::vector<float> own = program.answers();
  File whole[2] = {program.file(), program.file()};
  Builder(whole[0], width, false).build();
  Builder(whole[1], width, true).build();
  Random random(17);
  int planted_count = 0;
  for (int round = 0; round < rounds; round++) {
    auto file = std::make_unique<File>(whole[random.below(2)]);
    for (std::uint32_t changes = 1 + random.below(3); changes > 0; changes--) {
      std::uint32_t* words = &file->flags;
      std::size_t count = 1;
      switch (random.below(8)) {
        case 0: words = file->primitives.data(), count = file->primitives.size(); break;
        case 1: words = reinterpret_cast<std::uint32_t*>(file->triangles.data()), count = file->triangles.size(); break;
        case 2: words = &file->geometries[0].instance, count = 8 * file->geometries.size(); break;
        case 3: break;
        default: words = reinterpret_cast<std::uint32_t*>(file->nodes.data()), count = 8 * file->nodes.size(); break;
      }
      const std::uint32_t odd[] = {0, 1, leaf_bit, leaf_bit | 7, 0xFFFFFFFFu, 0x7FC00000u, 0x7F800000u,
                                   static_cast<std::uint32_t>(random.bits())};
      std::uint32_t& word = words[random.below(count)];
      word = random.below(2) == 0 ? odd[random.below(8)] : word ^ 1u << random.below(32);
    }
    if (round % 8 == 0) {
      // In memory of just that length.
      File cut = *file;
      const auto shorten = [&](auto& array, std::size_t step) {
        array.resize(step * random.below(array.size() / step));
        array.shrink_to_fit();
      };
      switch (random.below(4)) {
        case 0: shorten(cut.nodes, 1); break;
        case 1: shorten(cut.primitives, 1); break;
        case 2: shorten(cut.triangles, 9); break;
        default: shorten(cut.geometries, 1); break;
      }
      *file = std::move(cut);
    }
    std::unique_ptr<PlantedTree> planted;
    const std::string why = refusal(program, *file, planted);
    CHECK(why.find('\n') == std::string::npos);
    // What is planted does not need the file.
    file.reset();
    if (planted == nullptr) continue;
    planted_count++;
    CHECK(same(program.answers(), own));
    planted->restore();
  }
  std::printf("%d of %d damaged files planted\n", planted_count, rounds);
  CHECK(planted_count > 0 && planted_count < rounds);
}

// A leaf of some of the file's triangles, with a box around all of them.
ShimNode leaf_of(const File& file, std::uint32_t first, std::uint32_t count) {
  ShimNode node = file.nodes[0];
  node.first = first;
  node.count = leaf_bit | count;
  return node;
}

// Whole trees that Embree's kernels cannot follow, or of other scenes.
void foreign(const char* config, int flags, std::uint32_t width) {
  Program program(config, flags, 60, 3);
  const Program another(config, flags, 60, 4);
  const std::vector<float> own = program.answers();
  File file = program.file();
  Builder(file, width, false).build();
  const auto count = static_cast<std::uint32_t>(file.triangles.size() / 9);
  File all = file;
  all.primitives.clear();
  for (std::uint32_t triangle = 0; triangle < count; triangle++) all.primitives.push_back(triangle);
  const auto inner = [&](std::uint32_t first, std::uint32_t children) {
    ShimNode node = file.nodes[0];
    node.first = first;
    node.count = children;
    return node;
  };

  std::vector<File> files(7, all);
  files[0] = another.file();
  Builder(files[0], width, false).build();
  files[1] = file;
  std::swap(files[1].geometries[0].geometry, files[1].geometries[2].geometry);
  files[2] = file;
  files[2].geometries[0].geometry = 1u << 30;
  files[3].nodes.assign(1, leaf_of(file, 0, count));
  // One triangle more on each level.
  files[4].nodes.assign(1, inner(1, 2));
  for (std::uint32_t triangle = 0; triangle + 1 < count; triangle++) {
    const auto next = static_cast<std::uint32_t>(files[4].nodes.size()) + 2;
    const bool last = triangle + 2 == count;
    files[4].nodes.push_back(leaf_of(file, triangle, 1));
    files[4].nodes.push_back(last ? leaf_of(file, triangle + 1, 1) : inner(next, 2));
  }
  // More children than any node has room for.
  files[5].nodes.assign(1, inner(1, 0));
  for (std::uint32_t first = 0; first < count; first += 10) {
    files[5].nodes.push_back(leaf_of(file, first, std::min(10u, count - first)));
    files[5].nodes[0].count++;
  }
  // One that is its own grandchild.
  files[6].nodes = {inner(1, 1), inner(1, 1)};
  for (const File& one : files) {
    std::unique_ptr<PlantedTree> planted;
    const std::string why = refusal(program, one, planted);
    CHECK(!why.empty() && why.find('\n') == std::string::npos && planted == nullptr);
    CHECK(same(program.answers(), own));
  }
}

}  // namespace

int main(int count, char** words) {
  if (count != 5) return 2;
  const char* config = words[1];
  const int flags = std::atoi(words[2]);
  const auto width = static_cast<std::uint32_t>(std::atoi(words[3]));
  if (!Program(config, flags, 1, 0).is_there()) {
    std::printf("this processor has no %s\n", config);
    return 0;
  }
  commits(config, flags, width);
  threads(config, flags, width);
  foreign(config, flags, width);
  damage(config, flags, width, std::atoi(words[4]));
  return 0;
}
