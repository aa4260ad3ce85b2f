//! All integration tests of `wimu` in one binary: one module a file.

mod array_calibration;
mod array_truth;
mod arrays;
mod broken_boards;
mod button;
mod calibration_input;
mod cli;
mod coarse_and_fine;
mod cold_starts;
mod comparisons;
#[cfg(target_os = "linux")]
mod compat;
mod dashboard;
mod demo;
mod escapes;
mod files_people_bring;
mod flash;
#[cfg(target_os = "linux")]
mod fleet;
#[cfg(target_os = "linux")]
mod fleet_campaign;
mod full_disk;
mod gyroscope;
mod hostile;
mod keys;
mod kit;
mod line_rates;
mod live;
#[cfg(target_os = "linux")]
mod live_case;
mod localize;
mod magnetometer;
mod messages;
mod monitor;
mod multi_range;
mod navigate;
mod navigate_calibrated;
mod navigate_input;
mod noise;
mod other_keys;
mod ranges;
mod real_time;
mod recording;
mod reference_input;
mod relative;
mod report_pages;
mod round_trip;
mod screens;
mod session;
mod several_sessions;
mod six_axes;
mod smallest_device;
mod streams;
mod writes;
