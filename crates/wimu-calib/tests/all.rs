//! All integration tests of `wimu-calib` in one binary: one module a file.

mod alignment;
mod array;
mod bad_pose;
mod combined;
mod common;
mod finder;
mod guide;
mod gyroscope;
mod gyroscope_data;
mod honesty;
mod judgement;
mod magnetometer;
mod multi_position;
mod noise;
mod priors;
mod real_data;
mod reference;
mod rounding;
mod self_check;
mod session;
mod six_position;
mod turns;
mod visits;
