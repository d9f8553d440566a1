// Shapes of the interface, as far as the page reads them; the whole is in /api/openapi.json.

export type State =
  | "idle" | "pre-flight" | "armed" | "running" | "holding" | "stopping" | "stopped" | "aborted";

export interface Meters {
  table_acceleration_m_s2: number; command_acceleration_m_s2: number; mass_acceleration_m_s2: number;
  model_acceleration_m_s2: number; relative_displacement_m: number; excursion_m: number;
  model_excursion_m: number; phase_deg: number; oscillations: number; contacts: number;
  frequency_hz: number; residual_a: number; residual_d: number;
}

export interface Line { name: string; ok: boolean; required: boolean; found: string }
export interface AtRest { channel: string; zero: number; noise: number; gain: number; unit: string }
export interface Checked {
  id: number; at_utc: string; lines: Line[]; channels: AtRest[]; chain_delay_s: number | null;
  table_gain: number | null; steps: number; duration_s: number; passed: boolean;
}

export interface Running {
  id: string; name: string; step: number | null; steps: number; frequency_hz: number | null;
  direction: string | null; progress: number; eta_s: number; elapsed_s: number; nrmse_a: number;
  nrmse_d: number; slips: number; lost_samples: number; finished: number; real_time: string | null;
  ring_fill: number;
  evidence: { steps: number; candidates: { name: string; evidence_nats: number }[] } | null;
}

export interface Percentiles { p50_us: number; p99_us: number; p999_us: number; max_us: number; mean_us: number }
export interface Timing {
  cycles: number; slips: number; skipped_periods: number; wake_up_latency: Percentiles;
  period_error: Percentiles; step: Percentiles; phases: ({ phase: string } & Percentiles)[];
  latency_histogram?: [number, number][];
}

export interface Ended {
  id: string; outcome: string; samples: number; lost_samples: number; slips: number; clean: boolean;
  nrmse_a: number; nrmse_d: number; timing: Timing;
}

export interface Status {
  state: State; since_utc: string; possible: string[];
  cause: { detector: string; text: string; at_utc: string } | null;
  interlocks: { name: string; ok: boolean; text: string }[];
  checked: Checked | null; checking: boolean;
  setup: {
    name: string; case: string | null; rig: string; simulated: boolean; model: string; effects: string[];
    undos: number; acceleration_g: number; total_gap_m: number | null; reach_m: number; sample_rate_hz: number;
  };
  run: Running | null; ended: Ended | null; meters: Meters; version: string;
}

export interface Step {
  index: number; direction: "forward" | "backward"; frequency_hz: number; a_max_m_s2: number;
  excursion_m: number; model_a_max_m_s2: number; model_excursion_m: number; nrmse_a: number;
  nrmse_d: number; table_amplitude_ratio: number;
}

export interface Expected {
  index: number; frequency_hz: number; direction: "forward" | "backward"; a_max_m_s2: number; excursion_m: number;
}

export interface Sweep {
  start_hz?: number; stop_hz?: number; step_hz?: number; steps_per_octave?: number; frequencies_hz?: number[];
  dwell_hz?: number; cycles: number; direction: string; acceleration_g: number; transition: string;
  transition_cycles: number; ramp_cycles: number; settling?: { tolerance: number; max_cycles: number };
  cycles_per_step?: number[];
}

export interface Effect { name: string; expression?: string; [parameter: string]: unknown }
export interface Model {
  name: string; mass_kg: number;
  isolator: { stiffness_n_m: number | number[]; breakpoints_m?: number[]; damping_n_s_m: number };
  bumper?: { stiffness_n_m: number; damping_n_s_m: number; total_gap_m: number };
  effect?: Effect[]; [key: string]: unknown;
}

export interface SetUp {
  name: string; case: string | null; sweep: Sweep; model: Model; undos: number; sweeps: string[]; models: string[];
}

export interface Use {
  quantity: string; unit: string; asked: number; allowed: number; used: number; frequency_hz: number; place: string;
}
export interface Asks {
  fits: boolean; refused: string | null; steps: number; duration_s: number; uses: Use[];
  rows: {
    index: number; frequency_hz: number; direction: string; place: string; displacement_m: number;
    velocity_m_s: number; acceleration_m_s2: number; jerk_m_s3: number; force_n: number;
  }[];
}

export interface RunShort {
  id: string; name: string; state: string; cause: string | null; case: string | null; started_utc: string;
  clean: boolean; samples: number; lost_samples: number; model: string | null; note: string | null;
}

export interface Cycles {
  step: number; frequency_hz: number; time_s: number[]; phase_deg: number[]; table_acceleration_m_s2: number[];
  mass_acceleration_m_s2: number[]; relative_displacement_m: number[]; model_acceleration_m_s2: number[];
  model_displacement_m: number[];
}

export interface Parameter {
  name: string; unit: string; about: string; prior: [number, number]; start: number; log_scale: boolean;
  sign: string; default: number | null;
}
export interface Entry {
  name: string; place: string; equation: string; source: string; shows: string; experiment: string;
  parameters: Parameter[];
}

export interface Slice {
  name: string; share_of_samples: number; nrmse_a: number | null; nrmse_d: number | null;
  share_of_misfit_a: number | null; share_of_misfit_d: number | null; share_of_misfit_force: number | null;
}
export interface Failure {
  comparison: {
    model: string; sentence: string; regimes: Slice[]; directions: Slice[]; phases: Slice[]; amplitudes: Slice[];
    error: {
      nrmse_a: number | null; nrmse_d: number | null; noise_floor_a: number | null; noise_floor_d: number | null;
    };
    notes: string[]; quality: { text: string; severity: string }[];
  };
  map: {
    steps: { index: number; frequency_hz: number; direction: string | null }[]; bins: number;
    nrmse_a: (number | null)[][]; nrmse_d: (number | null)[][];
  };
}

export interface Estimate { value: number; low95: number; high95: number; unit: string }
export interface Diagnosis {
  verdict: "adequate" | "missing" | "ambiguous" | "outside-catalogue";
  effects: { name: string; probability: number; parameters: Record<string, Estimate>; error_after: number | null }[];
  refused: { name: string; reason: string }[];
  error_before: number; error_reidentified: number; error_after: number; noise_floor: number;
  ambiguous_with: string[];
  next_test: {
    title: string; reason: string; expected_discrimination: number;
    sweep: {
      start_hz: number; stop_hz: number; step_hz: number; cycles: number; acceleration_g: number;
      without_bumpers: boolean; total_gap_m: number | null;
    } | null;
  } | null;
  missing_force: {
    displacement_m: number[]; velocity_m_s: number[]; force_n: (number | null)[][]; sigma_n: (number | null)[][];
    explained_by_surface: number; power_in_contact: number; time_in_contact: number;
    expression: { expression: string; parameters: Record<string, number>; explains: number } | null;
  } | null;
  ladder: { model: string; training: number; held_out: number }[];
  reidentified: { key: string; nominal: number; value: number; low95: number; high95: number; at_limit: boolean }[];
  not_identifiable: string[]; notes: string[]; share_left: number; wall_s: number;
}

export interface Job<T> { id: number; state: "waiting" | "running" | "done" | "failed"; elapsed_s: number; result: T | null; error: string | null }

export interface Health {
  version: string; system: string; rig: string; up_s: number; memory_bytes: number; disk_free_bytes: number;
  runs_folder: string; ring_fill: number; clients: number; frames_dropped: number; frames_sent: number;
  stop_latency_s: number; real_time: string | null; timing: Timing | null; slips: number; lost_samples: number;
  links: { name: string; count: number }[] | null; journal: string | null;
  publication: { server: string; table: string; connected: boolean; messages: number; frames_dropped: number; waiting_bytes: number; error: string | null } | null;
}

export interface Rights { view: boolean; operate: boolean; configure: boolean }
