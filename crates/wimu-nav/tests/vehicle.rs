//! A unit in a vehicle against simulated truth.

use crate::common;

use common::Random;
use common::drive::{ANTENNA_M, CLOCK_S, Moment, begin, drive, mounting, push};
use nalgebra::Vector3;
use wimu_nav::navigator::Navigator;
use wimu_nav::state::POSITION;
use wimu_testkit::Lane;

const LENGTH_S: f64 = 130.0;
/// An outage of 30 s begins here, s.
const OUTAGE_S: f64 = 100.0;
const NEVER: f64 = f64::INFINITY;

fn followed(drive: &[Moment], vehicle: bool, seed: u64) -> Navigator {
    let mut navigator = begin(drive, vehicle);
    let mut random = Random::new(seed);
    for k in 0..drive.len() {
        push(&mut navigator, drive, k, (k as f64) * 0.01 < OUTAGE_S, &mut random);
    }
    navigator
}

#[test]
fn the_forward_axis_bridges_an_outage_and_its_covariance_is_consistent() {
    let (mut with, mut without, mut nees) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..Lane::current().choose([2, 3, 6]) {
        let drive = drive(LENGTH_S, seed, NEVER);
        let truth = drive.last().unwrap().position_m;
        for vehicle in [true, false] {
            let navigator = followed(&drive, vehicle, seed + 100);
            let error = navigator.filter().state.get(POSITION) - truth;
            if vehicle {
                let covariance = navigator.filter().covariance(POSITION);
                nees.push(error.dot(&covariance.cholesky().unwrap().solve(&error)));
                with.push(error.norm());
            } else {
                without.push(error.norm());
            }
        }
    }
    let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
    println!("{with:.2?} {without:.2?} {nees:.2?}");
    assert!(mean(&with) < 6.0, "{with:?}");
    assert!(mean(&without) > 3.0 * mean(&with), "{without:?} {with:?}");
    // Three degrees of freedom: the noise that is assumed is larger than that of the simulation.
    assert!((0.05..6.0).contains(&mean(&nees)), "{nees:?}");
}

#[test]
fn clock_antenna_and_forward_axis_are_found_within_their_deviations() {
    let drive = drive(OUTAGE_S, 7, NEVER);
    let navigator = followed(&drive, true, 8);
    let (filter, vehicle) = (navigator.filter(), navigator.vehicle().unwrap());
    let clock = filter.state.get(vehicle.clock()).x;
    let sd = filter.covariance(vehicle.clock()).x.sqrt();
    assert!((clock - CLOCK_S).abs() < 3.0 * sd && sd < 0.02, "{clock} ± {sd}");
    let offset = filter.state.get(vehicle.antenna_offset()) - Vector3::from(ANTENNA_M);
    let covariance = filter.covariance(vehicle.antenna_offset());
    for axis in 0..3 {
        let sd = covariance[(axis, axis)].sqrt();
        assert!(offset[axis].abs() < 3.5 * sd, "{offset} {covariance}");
    }
    let block = vehicle.forward().expect("known after a drive");
    let forward = filter.state.get(block).normalize();
    let truth = mounting().inverse() * Vector3::x();
    let off = forward.cross(&truth).norm();
    assert!(off < 0.02, "{forward} {truth}");
    assert_eq!(vehicle.turns(), 0);
}

#[test]
fn a_unit_that_is_turned_in_its_mount_is_noticed_once_and_found_anew() {
    let drive = drive(90.0, 9, 60.0);
    let navigator = followed(&drive, true, 10);
    let vehicle = navigator.vehicle().unwrap();
    assert_eq!(vehicle.turns(), 1);
    let forward = navigator.filter().state.get(vehicle.forward().unwrap()).normalize();
    let truth = drive.last().unwrap().attitude.inverse() * {
        let before = &drive[drive.len() - 2];
        (drive.last().unwrap().position_m - before.position_m).normalize()
    };
    // The unit itself moves sideways by its lever arm.
    assert!(forward.dot(&truth) > 0.99, "{forward} {truth}");
}

#[test]
fn wheels_that_slip_are_not_used_and_their_scale_is_found() {
    let drive = drive(LENGTH_S, 11, NEVER);
    let truth = drive.last().unwrap().position_m;
    let errors: Vec<_> = [false, true]
        .into_iter()
        .map(|slips| {
            let mut navigator = begin(&drive, true);
            let mut random = Random::new(12);
            let (mut slipped, mut failed) = (0, 0);
            for k in 0..drive.len() {
                let t = k as f64 * 0.01;
                push(&mut navigator, &drive, k, t < OUTAGE_S, &mut random);
                if k.is_multiple_of(10) {
                    // The wheels are 3 % smaller than stated; they spin for 2 s within the outage.
                    let spin = if slips && (110.0..112.0).contains(&t) { 1.5 } else { 1.0 };
                    slipped += i32::from(spin > 1.0);
                    let speed_mps = drive[k].speed_mps / 1.03 * spin + random.normal() * 0.05;
                    let used = navigator.odometer(speed_mps);
                    failed += i32::from(used.is_some_and(|innovation| !innovation.accepted));
                }
            }
            let vehicle = *navigator.vehicle().unwrap();
            let scale = navigator.filter().state.get(vehicle.scale()).x;
            assert!((scale - 0.03).abs() < 0.01, "{scale}");
            assert!((slipped..slipped + 20).contains(&failed), "{failed} of {slipped}");
            (navigator.filter().state.get(POSITION) - truth).norm()
        })
        .collect();
    println!("{errors:.2?}");
    assert!(errors.iter().all(|error| *error < 4.0), "{errors:?}");
}
