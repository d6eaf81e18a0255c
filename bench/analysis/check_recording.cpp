#include "bench/analysis/check_recording.h"

#include "bench/analysis/recorded_ports.h"
#include "bench/expect/expectations.h"
#include "bench/run/recorded_events.h"
#include "bench/run/recording.h"

namespace rigor {
namespace {

/// The recorded rig, with what is to be expected of it.
Result<RigConfig> rig_to_check(const RecordedRun& run, const std::filesystem::path& recording,
                               const CheckBy& by) {
  if (by.rig.empty()) {
    auto rig = recorded_rig(run, recording, by.overrides);
    if (rig && rig->expect.empty())
      return fail(ErrorCode::bad_input, recording.string(),
                  "expected a recording whose rig has `expect:`, got one without; name a RIG that has it");
    return rig;
  }
  auto rig = recorded_rig(run, recording);
  if (!rig) return rig;
  const auto other = load_rig(by.rig, by.overrides);
  if (!other) return tl::unexpected<Error>(other.error());
  if (other->expect.empty())
    return fail(ErrorCode::bad_input, by.rig.string(), "expected a rig that has `expect:`, got one without");
  rig->expect = other->expect;
  return rig;
}

}  // namespace

Result<CheckedRecording> check_recorded_run(const std::filesystem::path& recording, const CheckBy& by) {
  const auto run = read_recorded_run(recording);
  if (!run) return tl::unexpected<Error>(run.error());
  const auto rig = rig_to_check(*run, recording, by);
  if (!rig) return tl::unexpected<Error>(rig.error());
  const auto expectations = Expectations::read(*rig);
  if (!expectations) return tl::unexpected<Error>(expectations.error());
  auto opened = RecordedPorts::open(recording, *rig, *run);
  if (!opened) return tl::unexpected<Error>(opened.error());
  RecordedPorts& ports = **opened;
  Expectations& expect = **expectations;
  if (auto s = expect.bind(ports.ports()); !s) return tl::unexpected<Error>(s.error());
  const auto events = read_recorded_events(recording, *run);
  if (!events) return tl::unexpected<Error>(events.error());
  if (expect.need_faults())
    if (auto s = faults_are_known(recording, *events); !s) return tl::unexpected<Error>(s.error());

  expect.begin(run->t0);
  auto fault = events->faults.begin();
  auto made_safe = events->made_safe.begin();
  while (true) {
    const auto more = ports.next();
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    for (; fault != events->faults.end() && fault->t <= ports.now(); ++fault)
      expect.fault(fault->of, fault->kind, fault->begins);
    for (; made_safe != events->made_safe.end() && made_safe->t <= ports.now(); ++made_safe)
      if (made_safe->sink < rig->sinks.size())
        expect.made_safe(*ports.ports().outputs.at(rig->sinks[made_safe->sink].name), made_safe->t);
    for (const RecordedPorts::Given& g : ports.commands()) expect.command(*g.port, g.command);
    expect.cycle(ports.now());
  }

  RunEnd end;
  end.extent = RunEnd::Extent::recording;
  end.skipped = ports.skipped();
  for (const RecordedAlarm& a : events->alarms) end.alarms.push_back({a.pair, (a.t - run->t0).seconds()});
  CheckedRecording out;
  out.rig = rig->name;
  out.expected = expect.finish(end);
  out.cycles = ports.cycles();
  if (out.cycles > 0) out.duration_s = (ports.now() - run->t0 + rig->loop.period).seconds();
  out.cut_short = run->cycles == 0;
  out.missing_samples = ports.missing_samples();
  return out;
}

}  // namespace rigor
