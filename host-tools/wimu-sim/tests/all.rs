//! All integration tests of `wimu-sim` in one binary: one module a file.

mod adxl345;
mod clocks;
mod compare;
mod driver;
mod faults;
mod fifo_bench;
mod live_ranges;
mod long_files;
mod lsm303agr_fifo;
mod lsm6dso;
mod motion;
mod multi_range;
mod physics;
mod pipe;
mod session;
mod six_axes;
