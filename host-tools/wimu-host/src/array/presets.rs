//! Geometries that have a name.

use wimu_nav::array::{Geometry, GeometryError};

use super::{ArrayGeometry, SingleAxis};
use crate::{Code, Result};

/// What they are called, and their lengths.
const KNOWN: &str = "cube:SIDE (six single axes after Chen, Lee & DeBra), four:ARM (four triads at alternate corners of a cube, ARM \
                     from its centre), octahedron:ARM (six triads), board:HALF_SIDE,HALF_THICKNESS (eight triads on both sides), lengths in mm or \
                     m, for example cube:100mm";

/// The geometry of a name such as `cube:100mm`, `four:30mm`, `octahedron:0.03m` or `board:9.5mm,2mm`, triads in the axes of the
/// body, in the order of `wimu_nav::array::Geometry`'s; `None` where it is no name of one.
///
/// # Errors
/// `usage` for lengths that are none or too few.
///
/// ```
/// use wimu_host::array::preset;
///
/// let cube = preset("cube:100mm").expect("a preset")?;
/// assert_eq!((cube.axes.len(), cube.axes[5].place_m), (6, [0.0, 0.0, 0.05]));
/// assert!(preset("hexagon:3mm").is_some_and(|none| none.is_err()));
/// assert!(preset("places.csv").is_none() && preset("cube:100").is_some_and(|cube| cube.is_err()));
/// # Ok::<(), wimu_host::Problem>(())
/// ```
pub fn preset(text: &str) -> Option<Result<ArrayGeometry>> {
    let (name, lengths) = text.split_once(':')?;
    let usage = |message: String| Code::Usage.error(message, format!("give {KNOWN}"));
    let lengths: Option<Vec<f64>> = lengths.split(',').map(metres).collect();
    let count = match name {
        "cube" | "four" | "octahedron" => 1,
        "board" => 2,
        // With lengths it is no name of a file.
        _ => {
            return lengths.map(|_| Err(usage(format!("there is no preset `{name}`"))));
        }
    };
    let Some(lengths) = lengths.filter(|all| all.len() == count) else {
        return Some(Err(usage(format!("`{text}` has not the lengths it needs"))));
    };
    let at = |index: usize| lengths.get(index).copied().unwrap_or_default();
    let found = match name {
        "cube" => Geometry::chen_cube(at(0), 1.0)
            .map(|cube| ArrayGeometry::of_axes(cube.axes().iter().map(SingleAxis::from).collect())),
        "four" => Geometry::four_triads(at(0), 1.0).map(|all| triads(&all)),
        "octahedron" => Geometry::octahedron(at(0), 1.0).map(|all| triads(&all)),
        _ => Geometry::eight_triads_board(at(0), at(1), 1.0).map(|all| triads(&all)),
    };
    Some(found.map_err(|error: GeometryError| usage(error.to_string())))
}

fn triads<const M: usize>(geometry: &Geometry<M>) -> ArrayGeometry {
    let places: Vec<[f64; 3]> =
        geometry.axes().iter().step_by(3).map(|axis| axis.position_m).collect();
    ArrayGeometry::at(&places)
}

/// `100mm` or `0.1m`, positive.
fn metres(text: &str) -> Option<f64> {
    let text = text.trim();
    let (number, unit) = match text.strip_suffix("mm") {
        Some(number) => (number, 1e-3),
        None => (text.strip_suffix('m')?, 1.0),
    };
    let value = number.trim().parse::<f64>().ok()? * unit;
    (value > 0.0 && value.is_finite()).then_some(value)
}
