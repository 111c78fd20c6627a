//! A step allocates nothing, with any effect.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use whirlstand_vehicle::{Effect, Simulator, Vehicle, builtin_names};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged; counting touches only a thread-local without a
// destructor, which allocates nothing itself.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(vehicle: &Vehicle) -> usize {
    let mut simulator = Simulator::new(vehicle, 0.005, 1).unwrap();
    let u = vec![0.3; vehicle.inputs.len()];
    let push = vec![0.01; vehicle.states.len()];
    let before = ALLOCATIONS.with(Cell::get);
    for k in 0..2000 {
        if k == 1000 {
            simulator.disturb(&push);
        }
        simulator.measure();
        simulator.step(&u);
    }
    ALLOCATIONS.with(Cell::get) - before
}

#[test]
fn the_counter_counts() {
    let before = ALLOCATIONS.with(Cell::get);
    std::hint::black_box(vec![1u8; 100]);
    assert_eq!(ALLOCATIONS.with(Cell::get) - before, 1);
}

#[test]
fn plain_steps_allocate_nothing() {
    for name in builtin_names() {
        assert_eq!(allocations(&Vehicle::builtin(name).unwrap()), 0, "{name}");
    }
}

#[test]
fn steps_with_every_effect_allocate_nothing() {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    for text in EFFECTS {
        let effect: Effect = toml::from_str(&text.replace("; ", "\n")).unwrap();
        vehicle.add_effect(effect).unwrap();
    }
    let used: std::collections::BTreeSet<_> = vehicle.effects.iter().map(Effect::kind).collect();
    assert_eq!(used.len(), whirlstand_vehicle::SPECS.len(), "every effect is used");
    assert_eq!(allocations(&vehicle), 0);
}

const EFFECTS: &[&str] = &[
    "effect = 'input_delay'; where = 'u_roll'; delay_s = 0.033",
    "effect = 'actuator_lag'; where = 'u_roll'; time_constant_s = 0.05",
    "effect = 'input_gain'; where = 'u_pitch'; factor = 0.9",
    "effect = 'gain_drift'; where = 'u_pitch'; rate_per_s = -0.01",
    "effect = 'input_bias'; where = 'u_pitch'; offset = 0.1",
    "effect = 'dead_zone'; where = 'u_roll'; width = 0.05",
    "effect = 'input_saturation'; where = 'u_roll'; lower = -3; upper = 3",
    "effect = 'rate_limit'; where = 'u_roll'; limit_per_s = 5",
    "effect = 'backlash'; where = 'u_roll'; width = 0.1",
    "effect = 'input_coupling'; where = 'u_roll->u_pitch'; coefficient = 0.2",
    "effect = 'parameter_change'; where = 'A[2,1]'; factor = 1.2",
    "effect = 'quadratic_drag'; where = 'lateral_speed'; coefficient = 0.1",
    "effect = 'coulomb_friction'; where = 'roll_rate'; level = 0.05",
    "effect = 'cubic_stiffness'; where = 'roll->roll_rate'; coefficient = 1.0",
    "effect = 'unmodelled_mode'; where = 'u_pitch'; frequency_hz = 8; damping_ratio = 0.05",
    "effect = 'step_disturbance'; where = 'pitch_rate'; at_s = 1.0012; magnitude = 0.1",
    "effect = 'pulse_disturbance'; where = 'roll_rate'; at_s = 2.0012; duration_s = 0.2; magnitude = 1",
    "effect = 'periodic_disturbance'; where = 'roll_rate'; frequency_hz = 2; amplitude = 0.1",
    "effect = 'turbulence'; where = 'lateral_speed'; std = 0.3; bandwidth_hz = 0.5",
    "effect = 'mode_transition'; where = 'vehicle'; at_s = 5.001; to = 'helicopter-lateral'",
    "effect = 'sensor_bias'; where = 'roll'; offset = '1 deg'",
    "effect = 'sensor_drift'; where = 'roll'; rate_per_s = 0.001",
    "effect = 'sensor_scale'; where = 'pitch'; factor = 1.05",
    "effect = 'sensor_delay'; where = 'roll'; delay_s = 0.012",
    "effect = 'sensor_lag'; where = 'pitch'; time_constant_s = 0.03",
    "effect = 'misalignment'; where = 'roll,pitch'; angle_rad = 0.05",
    "effect = 'vibration'; where = 'roll'; frequency_hz = 17; amplitude = 0.01; source = 'tail rotor'",
    "effect = 'noise'; where = 'roll'; std = 0.01",
    "effect = 'quantization'; where = 'roll'; step = 0.001",
    "effect = 'output_saturation'; where = 'roll'; lower = -1; upper = 1",
    "effect = 'dropouts'; where = 'roll'; fraction = 0.1",
    "effect = 'outliers'; where = 'roll'; fraction = 0.01; magnitude = 0.1",
];
