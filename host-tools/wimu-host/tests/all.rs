//! All integration tests of `wimu-host` in one binary: one module a file.

mod array_coverage;
mod array_input;
mod array_journeys;
mod array_survey;
mod arrays;
mod calibration_faults;
mod common;
mod export_calibration;
mod feet;
mod fixes;
mod formats_document;
mod hand_eye;
mod inertial;
mod localization;
mod relative;
mod rig;
mod ros_topics;
mod violent;
