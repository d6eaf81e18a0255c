// Faults as the form offers them. The bench checks what is asked for; this only says what there is to fill in.
//
// A parameter's key may hold UNIT: then the unit of the value that is changed takes its place ("amount_UNIT" of a range is
// "amount_m", of a register "amount").

const probability = { key: "probability", least: 0, most: 1, value: 1, step: 0.05 };

export const FAULT_KINDS = {
  drop: { says: "samples are lost", at: "all", keys: [probability] },
  burst_loss: { says: "samples are lost in runs", at: "all", keys: [{ key: "share", least: 0, most: 1, value: 0.2, step: 0.05 }, { key: "mean_burst", least: 1, value: 4, step: 1 }] },
  delay: { says: "samples come late", at: "all", keys: [{ key: "delay_ms", least: 0, value: 80 }, probability] },
  jitter: {
    says: "samples come late by a random time",
    at: "all",
    keys: [{ key: "shape", words: ["uniform", "exponential", "normal"] }, { key: "min_ms", least: 0, value: 0, when: "uniform" }, { key: "max_ms", least: 0, value: 40, when: "uniform" }, { key: "mean_ms", least: 0, value: 10, when: "exponential normal" }, { key: "sigma_ms", least: 0, value: 4, when: "normal" }],
  },
  stuck: { says: "the first content stays", at: "all", keys: [{ key: "freeze", flag: true, source: true }] },
  bias: { says: "a value is off", at: "values", keys: [{ key: "amount_UNIT", value: { dn: 20, m: 0.2, rad: 0.05 } }, probability] },
  drift: { says: "a value goes off", at: "values", keys: [{ key: "rate_UNIT_per_s", value: { dn: 5, m: 0.05, rad: 0.01 } }] },
  noise: { says: "Gaussian noise on a value", at: "values", keys: [{ key: "sigma_UNIT", least: 0, value: { dn: 10, m: 0.05, rad: 0.01 } }, probability] },
  spike: { says: "single values jump", at: "values", keys: [{ key: "amount_UNIT", value: { dn: 100, m: 1, rad: 0.3 } }, { key: "probability", least: 0, most: 1, value: 0.1, step: 0.05 }, { key: "share", least: 0, most: 1, value: 0.001, step: 0.001, kinds: "image range_image point_cloud" }] },
  corrupt: { says: "bits flip, ends are missing", at: "bytes", keys: [{ key: "flips", least: 0, value: 8, step: 1 }, { key: "keep", least: 0, most: 1, value: 1, step: 0.05 }, { key: "flagged", flag: true, value: true }, probability] },
  timestamp: { says: "the device stamps wrongly", at: "sources", keys: [{ key: "offset_ms", value: 20 }, probability] },
  clock_skew: { says: "the device's clock runs fast", at: "sources", keys: [{ key: "ppm", value: 200 }] },
  clock_step: { says: "the device's clock is off", at: "sources", keys: [{ key: "step_ms", value: 50 }] },
  disconnect: { says: "the device is gone", at: "all", keys: [] },
  slow_consumer: { says: "samples are not fetched", at: "sources", keys: [{ key: "mode", words: ["unread", "hold"] }, { key: "leases", least: 1, value: 4, step: 1, when: "hold" }] },
};

const BYTES = ["image", "range_image", "point_cloud", "can_frame"];

/// Kinds that a channel or sink can have. `place`: of the bench's `faults_at`.
export const kindsOf = (place) =>
  Object.entries(FAULT_KINDS)
    .filter(([, { at }]) => at === "all" || (at === "values" && (place.values.length > 0 || place.kind === "can_frame")) || (at === "sources" && place.kind !== "sink") || (at === "bytes" && BYTES.includes(place.kind)))
    .map(([kind]) => kind);
