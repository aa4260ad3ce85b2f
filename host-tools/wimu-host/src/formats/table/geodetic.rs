//! Latitude, longitude and altitude as positions east, north and up.

use nalgebra::{Matrix3, Vector3};

use super::measurements::{Column, Measurements};
use super::units::{LENGTH, Sizes};
use crate::{Code, Problem, Result};

/// WGS 84: equatorial radius, m, and square of the first eccentricity (NIMA TR8350.2, table 3.3).
const RADIUS_M: f64 = 6_378_137.0;
const ECCENTRICITY2: f64 = 6.694_379_990_14e-3;

/// Degrees: what receivers write without a unit.
const DEGREES: Sizes = &[(1.0, "deg"), (1.0, "")];
const ALTITUDE: Sizes = &[(1.0, "m"), (1.0, ""), (1e-2, "cm"), (1e-3, "mm")];

/// The axes east, north and up at a place: equation (197).
#[derive(Clone, Debug)]
pub(crate) struct TangentPlane {
    /// Latitude and longitude, degrees, and height above the ellipsoid, m.
    pub origin: [f64; 3],
    origin_m: Vector3<f64>,
    axes: Matrix3<f64>,
}

impl TangentPlane {
    /// At a latitude and longitude, degrees, and height above the ellipsoid, m.
    pub fn at(origin: [f64; 3]) -> Self {
        let ((sin_lat, cos_lat), (sin_lon, cos_lon)) =
            (origin[0].to_radians().sin_cos(), origin[1].to_radians().sin_cos());
        let axes = Matrix3::new(
            -sin_lon,
            cos_lon,
            0.0,
            -sin_lat * cos_lon,
            -sin_lat * sin_lon,
            cos_lat,
            cos_lat * cos_lon,
            cos_lat * sin_lon,
            sin_lat,
        );
        Self { origin, origin_m: centred(origin), axes }
    }

    /// East, north and up of a place, m.
    pub fn position(&self, place: [f64; 3]) -> [f64; 3] {
        (self.axes * (centred(place) - self.origin_m)).into()
    }

    /// Where positions are measured from.
    pub fn note(&self) -> Problem {
        let [latitude, longitude, height_m] = self.origin;
        let text = format!(
            "position is measured from the first fix: latitude {latitude:.7}°, longitude {longitude:.7}°, altitude {height_m:.2} m"
        );
        Code::Navigation.note(text)
    }
}

/// Earth-centred, Earth-fixed coordinates of a place, m.
fn centred([latitude, longitude, height_m]: [f64; 3]) -> Vector3<f64> {
    let (sin, cos) = latitude.to_radians().sin_cos();
    let (sin_lon, cos_lon) = longitude.to_radians().sin_cos();
    let normal_m = RADIUS_M / (1.0 - ECCENTRICITY2 * sin * sin).sqrt();
    let from_axis_m = (normal_m + height_m) * cos;
    let along_axis_m = (normal_m * (1.0 - ECCENTRICITY2) + height_m) * sin;
    Vector3::new(from_axis_m * cos_lon, from_axis_m * sin_lon, along_axis_m)
}

impl Measurements {
    /// Puts `Position E (m)`, `N` and `U` in the place of `Latitude`, `Longitude` and `Altitude`, in the axes of `plane`, or of
    /// the first row. 0°, 0° is what receivers write before their first fix: not measured.
    ///
    /// # Errors
    /// `csv_bad_number`, also of an angle outside its range.
    pub fn project(&mut self, plane: &mut Option<TangentPlane>) -> Result<()> {
        let angle = |names: &[&str]| self.column(names, DEGREES);
        let (Some(latitude), Some(longitude)) =
            (angle(&["Latitude", "Lat"]), angle(&["Longitude", "Lon", "Lng", "Long"]))
        else {
            return Ok(());
        };
        if self.column(&["Position E"], LENGTH).is_some() {
            return Ok(());
        }
        let altitude = self.column(&["Altitude", "Alt", "Height"], ALTITUDE);
        for row in 0..self.len() {
            let angles = [self.angle(row, latitude, 90.0)?, self.angle(row, longitude, 180.0)?];
            let height_m = altitude.map_or(Ok(None), |column| self.value(row, column))?;
            let mut enu = [None; 3];
            if let [Some(latitude), Some(longitude)] = angles
                && [latitude, longitude] != [0.0, 0.0]
            {
                let origin_m = plane.as_ref().map(|plane| plane.origin[2]);
                let place = [latitude, longitude, height_m.or(origin_m).unwrap_or_default()];
                let plane = plane.get_or_insert_with(|| TangentPlane::at(place));
                let [east, north, up] = plane.position(place);
                enu = [Some(east), Some(north), height_m.map(|_| up)];
            }
            self.set(row, longitude, enu[0]);
            self.set(row, latitude, enu[1]);
            if let Some(altitude) = altitude {
                self.set(row, altitude, enu[2]);
            }
        }
        self.rename(longitude, "Position E (m)");
        self.rename(latitude, "Position N (m)");
        if let Some(altitude) = altitude {
            self.rename(altitude, "Position U (m)");
        }
        Ok(())
    }

    fn angle(&self, row: usize, column: Column, most: f64) -> Result<Option<f64>> {
        let value = self.value(row, column)?;
        if value.is_none_or(|value| value.abs() <= most) {
            return Ok(value);
        }
        let text = self.text(row, column.0);
        let message = format!("`{text}` is beyond ±{most}°");
        let remedy = "give degrees with a fraction, such as 47.397742: neither degrees and minutes nor integers of 1e-7°";
        Err(Code::CsvBadNumber.error(message, remedy).at(self.place(row, column)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_a_degree_are_those_of_the_ellipsoid() {
        // NIMA TR8350.2 and Snyder, Map Projections, table 3: a degree of latitude is 110.574 km at the equator and 111.694 km at
        // the pole; one of longitude 111.320 km at the equator and 78.847 km at 45°.
        for (at, to, metres) in [
            ([-0.005, 7.0, 0.0], [0.005, 7.0, 0.0], [0.0, 1105.74, 0.0]),
            ([89.985, 7.0, 0.0], [89.995, 7.0, 0.0], [0.0, 1116.94, 0.0]),
            ([0.0, 7.0, 0.0], [0.0, 7.01, 0.0], [1113.20, 0.0, 0.0]),
            ([45.0, 179.995, 0.0], [45.0, -179.995, 0.0], [788.47, 0.0, 0.0]),
            ([47.0, 8.0, 400.0], [47.0, 8.0, 450.0], [0.0, 0.0, 50.0]),
        ] {
            let found = TangentPlane::at(at).position(to);
            let horizontal = (0..2).all(|k| (found[k] - metres[k]).abs() < 0.1);
            // The Earth bends away by the square of the distance over its diameter.
            assert!(horizontal && (found[2] - metres[2]).abs() < 0.2, "{at:?}: {found:?}");
        }
    }
}
