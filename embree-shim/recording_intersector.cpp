// Records what another Intersector is asked and answers: query + answer -> ShimRecord -> a batch of fixed size -> the sink.
//
// One object a thread, so nothing is locked; the batch is allocated once, so nothing is allocated per query. What is
// refused is not recorded: it was never traced. A sink that stops the recording is not called again; queries are still answered.
#include "recording_intersector.hpp"

#include <cstring>
#include <utility>

#include "record.hpp"

namespace shim {
namespace {

static_assert(sizeof(ShimQuery) == 48 && sizeof(ShimHit) == 32);

class RecordingIntersector final : public Intersector {
 public:
  RecordingIntersector(std::unique_ptr<Intersector> inner, ShimSink sink)
      : inner_(std::move(inner)), sink_(sink), batch_(new ShimRecord[SHIM_BATCH_RECORDS]) {}

  ~RecordingIntersector() override { flush(); }

  Outcome closest_hit(const Query& query, Hit& hit) noexcept override {
    const Outcome outcome = inner_->closest_hit(query, hit);
    record_closest_hit(query, hit, outcome);
    return outcome;
  }

  Outcome occluded(const Query& query) noexcept override {
    const Outcome outcome = inner_->occluded(query);
    record_occlusion(query, outcome);
    return outcome;
  }

  void closest_hits(const Query* queries, Width width, Hit* hits, Outcome* outcomes) noexcept override {
    inner_->closest_hits(queries, width, hits, outcomes);
    for (std::uint32_t lane = 0; lane < static_cast<std::uint32_t>(width); lane++) {
      record_closest_hit(queries[lane], hits[lane], outcomes[lane]);
    }
  }

  void occluded_packet(const Query* queries, Width width, Outcome* outcomes) noexcept override {
    inner_->occluded_packet(queries, width, outcomes);
    for (std::uint32_t lane = 0; lane < static_cast<std::uint32_t>(width); lane++) {
      record_occlusion(queries[lane], outcomes[lane]);
    }
  }

  bool flush() noexcept override {
    const bool inner = inner_->flush();
    if (used_ != 0) pass_on();
    return inner && !stopped_;
  }

  std::uint64_t refused() const noexcept override { return inner_->refused(); }

 private:
  void record_closest_hit(const Query& query, const Hit& hit, Outcome outcome) noexcept {
    if (outcome == Outcome::refused) return;
    ShimRecord& record = next(query, kind_closest_hit, outcome);
    const bool found = outcome == Outcome::hit;
    record.t = found ? hit.t : infinity;
    record.triangle = found ? hit.triangle : no_triangle;
    record.u = found ? hit.u : 0.0f;
    record.v = found ? hit.v : 0.0f;
    complete();
  }

  void record_occlusion(const Query& query, Outcome outcome) noexcept {
    if (outcome == Outcome::refused) return;
    ShimRecord& record = next(query, kind_occlusion, outcome);
    record.t = outcome == Outcome::hit ? -infinity : infinity;
    record.triangle = no_triangle;
    record.u = 0.0f;
    record.v = 0.0f;
    complete();
  }

  // The next record of the batch with all that comes from the query.
  ShimRecord& next(const Query& query, std::uint8_t kind, Outcome outcome) noexcept {
    // Origin to mask lie alike in both structs.
    static_assert(offsetof(ShimRecord, mask) == offsetof(ShimQuery, mask));
    ShimRecord& record = batch_[used_];
    std::memcpy(&record, &query, offsetof(ShimQuery, path));
    record.path = query.path;
    record.kind = kind;
    record.depth = query.depth;
    record.flags = static_cast<std::uint8_t>((outcome == Outcome::hit ? flag_hit : 0) |
                                             (query.coherent ? flag_coherent : 0));
    record.purpose = query.purpose;
    return record;
  }

  void complete() noexcept {
    if (++used_ == SHIM_BATCH_RECORDS) pass_on();
  }

  void pass_on() noexcept {
    if (!stopped_) stopped_ = sink_.batch(sink_.user, batch_.get(), used_) != 0;
    used_ = 0;
  }

  std::unique_ptr<Intersector> inner_;
  ShimSink sink_;
  std::unique_ptr<ShimRecord[]> batch_;
  std::uint64_t used_ = 0;
  bool stopped_ = false;
};

}  // namespace

std::unique_ptr<Intersector> make_recording_intersector(std::unique_ptr<Intersector> inner, ShimSink sink) {
  return std::make_unique<RecordingIntersector>(std::move(inner), sink);
}

}  // namespace shim
