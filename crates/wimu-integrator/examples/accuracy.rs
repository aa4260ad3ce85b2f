//! How far the integer trapezoid is from the same rule in f64, and what coarser arithmetic costs; the
//! same for the attitude from a gyroscope, and the error of a simulated hand motion.

use wimu_integrator::{Config, Integrator, Rotation, Segment};
use wimu_model::{AngularRateQ20, PeriodNs, SpecificForceQ16};
use wimu_testkit::{Random, figure};

#[path = "../tests/hand.rs"]
mod hand;

use hand::{Errors, G, Hand, Rule, angle_between, distance};

const LSB: f64 = 65536.0;

/// Three sines, m/s² at time t.
fn sines(t: f64) -> f64 {
    0.8 * (0.9 * t).sin() + 0.5 * (2.3 * t + 0.4).sin() + 0.3 * (5.1 * t + 1.0).sin()
}

/// Its exact double integral from rest.
fn sines_position(t: f64) -> f64 {
    [(0.8, 0.9, 0.0), (0.5, 2.3, 0.4), (0.3, 5.1, 1.0)]
        .iter()
        .map(|&(a, w, p): &(f64, f64, f64)| {
            a / (w * w) * (p.sin() - (w * t + p).sin()) + a / w * p.cos() * t
        })
        .sum()
}

/// The same rule in f64, compensated so that its own rounding does not hide ours.
#[derive(Default)]
struct Trapezoid {
    velocity: Compensated,
    position: Compensated,
    previous: Option<f64>,
}

#[derive(Default, Clone, Copy)]
struct Compensated {
    sum: f64,
    rest: f64,
}

impl Compensated {
    fn add(&mut self, value: f64) {
        let y = value - self.rest;
        let t = self.sum + y;
        self.rest = (t - self.sum) - y;
        self.sum = t;
    }
}

impl Trapezoid {
    fn step(&mut self, a: f64, dt: f64) {
        if let Some(previous) = self.previous.replace(a) {
            let before = self.velocity.sum;
            self.velocity.add((previous + a) * dt / 2.0);
            self.position.add((before + self.velocity.sum) * dt / 2.0);
        }
    }
}

fn main() {
    hour_at_1_khz();
    minute_at_100_hz();
    ten_minutes_of_attitude();
    hand_motion();
}

fn ten_minutes_of_attitude() {
    let mut fixed = Rotation::new([1.0, 0.0, 0.0, 0.0], PeriodNs(1_000_000));
    let mut rule = Rule::new([1.0, 0.0, 0.0, 0.0], G, 1e-3);
    let mut worst = 0.0_f64;
    for k in 0..=600_000_u32 {
        let t = f64::from(k) * 1e-3;
        let wave = |f: f64, p: f64| (std::f64::consts::TAU * f * t + p).sin();
        let rate = AngularRateQ20::from_rad_s([
            2.0 * wave(0.7, 0.3) + 1.1 * wave(2.3, 1.0),
            1.7 * wave(0.9, 1.9) + 0.8 * wave(3.1, 0.1),
            1.2 * wave(0.5, 2.7) + 1.5 * wave(1.7, 0.8),
        ]);
        fixed.step(rate);
        rule.step([0.0; 3], rate.to_rad_s());
        if k % 1000 == 0 {
            let off = angle_between(fixed.quaternion(), rule.attitude);
            worst = worst.max(off.to_degrees());
        }
    }
    figure(
        "attitude, 10 min of hand motion at 1 kHz, against the same rule in f64, degrees",
        format!("{worst:.1e}"),
        "at most 0.001",
        worst <= 1e-3,
    );
}

/// Final position errors, rms over motions with different noise.
fn hand_motion() {
    let hand = Hand { motion_s: 10.0 };
    let rms = |with_gyroscope| {
        let squares = (1..=8).map(|seed| {
            let Ok(config) = Config::new(hand::PERIOD) else {
                return f64::NAN;
            };
            let mut unit = Integrator::new(config);
            let mut random = Random::new(seed);
            for (force, rate, saturated) in
                hand.samples(hand::HZ, &Errors::lsm6dso(), || random.normal())
            {
                if with_gyroscope {
                    unit.step_inertial(force, rate, saturated);
                } else {
                    unit.step(force, false);
                }
            }
            let end = unit.navigation().position.to_m();
            distance(end, hand.position(hand.total_s())).powi(2)
        });
        (squares.sum::<f64>() / 8.0).sqrt()
    };
    let (six, three) = (rms(true), rms(false));
    figure(
        "simulated hand motion of 10 s with rotations, LSM6DSO, position with gyroscope, m rms",
        format!("{six:.3}"),
        "below 0.1",
        six < 0.1,
    );
    figure("for comparison: without gyroscope, m rms", format!("{three:.1}"), "–", true);
}

fn hour_at_1_khz() {
    let period = PeriodNs(1_000_000);
    let dt = period.to_seconds();
    // Gravity with a remainder that 2⁻¹⁶ m/s² cannot hold.
    let gravity = (9.812_345_678_9 * LSB * LSB) as i64;
    let whole = ((gravity + (1 << 15)) >> 16) as i32;
    let remainder = (gravity - (i64::from(whole) << 16)) as i32;
    let mut segment = Segment::default();
    let mut reference = Trapezoid::default();
    let mut worst = 0.0_f64;
    let mut farthest = 0.0_f64;
    for k in 0..=3_600_000_u32 {
        let t = f64::from(k) * dt;
        let force = ((sines(t) + gravity as f64 / (LSB * LSB)) * LSB).round() as i32;
        segment.step(SpecificForceQ16([0, 0, force]), [0, 0, whole]);
        reference.step(f64::from(force) / LSB - gravity as f64 / (LSB * LSB), dt);
        if k % 1000 == 0 {
            let position = segment.position_nm([0, 0, remainder], period)[2] as f64 * 1e-9;
            worst = worst.max((position - reference.position.sum).abs());
            farthest = farthest.max(position.abs());
        }
    }
    figure(
        "integrator, 1 h at 1 kHz, against the same rule in f64, µm",
        format!("{:.4} over {farthest:.0} m", worst * 1e6),
        "below 10",
        worst < 10e-6,
    );
}

fn minute_at_100_hz() {
    let period = PeriodNs(10_000_000);
    let dt = period.to_seconds();
    let mut segment = Segment::default();
    let (mut euler_v, mut euler_p) = (0.0, 0.0);
    let (mut shift_v, mut shift_p) = (0_i64, 0_i64);
    let mut previous = 0;
    for k in 0..=6000_u32 {
        let force = (sines(f64::from(k) * dt) * LSB).round() as i32;
        segment.step(SpecificForceQ16([force, 0, 0]), [0; 3]);
        if k > 0 {
            euler_v += f64::from(force) / LSB * dt;
            euler_p += euler_v * dt;
            // Q16 all the way, with a multiplication by dt and a truncating shift per step.
            let step = (i64::from(previous + force) / 2 * 655) >> 16;
            shift_p += ((2 * shift_v + step) * 655) >> 17;
            shift_v += step;
        }
        previous = force;
    }
    let exact = sines_position(60.0);
    let ours = segment.position_nm([0; 3], period)[0] as f64 * 1e-9;
    let off_mm = |position: f64| (position - exact).abs() * 1e3;
    let [ours, euler, shift] = [ours, euler_p, shift_p as f64 / LSB].map(off_mm);
    println!("three sines, 100 Hz, 60 s, against the exact integral of {exact:.3} m:");
    figure(
        "trapezoid against the exact integral, 100 Hz, 60 s, mm",
        format!("{ours:.2}"),
        "below 5",
        ours < 5.0,
    );
    figure("for comparison: Euler's rule in f64, mm", format!("{euler:.0}"), "–", true);
    figure(
        "for comparison: 16 fraction bits, truncating shifts, mm",
        format!("{shift:.0}"),
        "–",
        true,
    );
}
