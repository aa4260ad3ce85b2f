//! Heading by another system.

use wimu_nav::sensor::Heading;

use super::Kind;
use crate::formats::table::ANGLE;

/// Angle of the body x axis from east towards north. Usual σ: a compass.
pub static HEADING: Kind = Kind {
    name: "heading",
    one: "heading",
    columns: &[&["Heading"]],
    unit: ANGLE,
    usual_sd: Some(0.1),
    remedy: "headings are of the body x axis, from east towards north: of a compass, clockwise from north, give 90° minus it",
    update: |aid, to| to.with(Heading { heading_rad: aid.value[0], deviation_rad: aid.sd[0] }),
    ..Kind::DEFAULT
};
