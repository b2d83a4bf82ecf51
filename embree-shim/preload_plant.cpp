// A committed scene -> the trees whose geometries are its own, by number and kind -> the first of them that the planter takes.
#include "preload_plant.hpp"

#include <cerrno>
#include <cstdio>
#include <ctime>
#include <exception>

#include "preload_facts.hpp"

namespace preload {
namespace {

// A program that changes a scene with each frame has no tree made for it, and each look costs a pass over the triangles.
constexpr unsigned most_changes = 8;

double seconds_now() noexcept {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

const void* vertices_of(const void* scene, std::uint32_t geometry) {
  // Embree takes scenes that it does not change as others.
  auto* handle = static_cast<RTCScene>(const_cast<void*>(scene));
  RTCGeometry found = real().rtcGetGeometry(handle, geometry);
  return found == nullptr ? nullptr : real().rtcGetGeometryBufferData(found, RTC_BUFFER_TYPE_VERTEX, 0);
}

shim::Ground ground_of(const Committed& scene) noexcept {
  shim::Ground ground;
  ask_embree(scene.handle, ground);
  ground.spatial_splits = scene.spatial_splits;
  ground.others = scene.others;
  ground.vertices = &vertices_of;
  return ground;
}

ExchangeOutcome outcome_of(const Committed& scene, std::uint32_t what, const char* reason) noexcept {
  ExchangeOutcome outcome{};
  outcome.scene = scene.scene;
  outcome.commit = scene.commit;
  outcome.outcome = what;
  std::snprintf(outcome.reason, sizeof outcome.reason, "%s", reason);
  return outcome;
}

}  // namespace

void Planting::before_commit() noexcept {
  if (!stands_) return;
  planted_->restore();
  stands_ = false;
}

// Plants again what stood there before a commit without a change, if Embree has left its own tree as it was.
bool Planting::returns(const Committed& scene) noexcept {
  if (planted_ == nullptr || scene.changed) return false;
  try {
    if (!planted_->is_restored(ground_of(scene))) return false;
  } catch (const std::exception&) {
    return false;
  }
  planted_->make_current();
  stands_ = true;
  return true;
}

bool Planting::plant(const Committed& scene, const Trees& trees, std::size_t number) {
  const double started = seconds_now();
  ExchangeOutcome outcome = outcome_of(scene, EXCHANGE_LEFT, "there is no memory left");
  try {
    const Trees::Known& known = trees.known()[number];
    const shim::Ground ground = ground_of(scene);
    // Of many trees with the scene's counts, frames say, most are told apart without their arrays being read.
    if (!scene.others && !known.box.contains(ground.bounds[0])) {
      throw shim::Doubt("the box of its root does not hold what the scene holds");
    }
    const TreeArrays arrays(known.entry);
    planted_ = shim::plant(ground, arrays.file(), nullptr);
    stands_ = true;
    outcome.outcome = EXCHANGE_PLANTED;
    outcome.planted = planted_->describe();
    outcome.reason[0] = '\0';
  } catch (const std::exception& problem) {
    std::snprintf(outcome.reason, sizeof outcome.reason, "%s", problem.what());
  }
  outcome.tree = number;
  outcome.seconds = seconds_now() - started;
  trees.report(outcome);
  return stands_;
}

void Planting::after_commit(const Committed& scene) noexcept {
  const Trees* all = trees();
  if (all == nullptr || given_up_) return;
  if (stands_) {
    // Nobody has seen the commit begin, for want of memory: whether Embree still refers to ours is not known. So it stays.
    static_cast<void>(planted_.release());
    stands_ = false;
    given_up_ = true;
    all->report(outcome_of(scene, EXCHANGE_LEFT, "there was no memory left to follow its commits"));
    return;
  }
  // What was not planted is not planted now. What was and has gone is planted anew.
  if (returns(scene) || (!scene.changed && planted_ == nullptr)) return;
  const int saved = errno;
  planted_.reset();
  bool found = false;
  for (std::size_t number = 0; number < all->known().size() && !stands_; number++) {
    const std::vector<Count>& counts = all->known()[number].counts;
    if (counts.empty() || !(counts == scene.counts)) continue;
    if (!found && ++changes_ > most_changes) {
      given_up_ = true;
      all->report(outcome_of(scene, EXCHANGE_CHANGES, "it is committed with changes again and again"));
      break;
    }
    found = true;
    plant(scene, *all, number);
  }
  if (!found && !given_up_ && !told_ && !scene.counts.empty()) {
    told_ = true;
    all->report(outcome_of(scene, EXCHANGE_UNKNOWN, ""));
  }
  errno = saved;
}

}  // namespace preload
