//! Local gravity, the reference of a calibration.

use wimu_model::STANDARD_GRAVITY_MPS2;

/// Local gravity and its standard deviation.
///
/// 9.7..=9.9 m/s², which covers the surface of the Earth (9.764 to 9.834).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    mps2: f64,
    sd_mps2: f64,
}

impl Gravity {
    /// 9.80665 ± 0.015 m/s² (1 σ): an unknown location on Earth.
    pub const UNKNOWN_PLACE: Self = Self { mps2: STANDARD_GRAVITY_MPS2, sd_mps2: 0.015 };

    /// Gravity in m/s² and its standard deviation in m/s², 0 where it is taken as exact. `None` when gravity is outside
    /// 9.7..=9.9 m/s² or the deviation outside 0..=0.1.
    pub fn new(mps2: f64, sd_mps2: f64) -> Option<Self> {
        let is_possible = (9.7..=9.9).contains(&mps2) && (0.0..=0.1).contains(&sd_mps2);
        is_possible.then_some(Self { mps2, sd_mps2 })
    }

    /// Normal gravity of the WGS 84 ellipsoid at a geodetic latitude, degrees, and a height above the
    /// ellipsoid, m, ± 0.0005 m/s² (1 σ). Equation (156), NIMA TR8350.2. The height above sea level
    /// serves too: it differs by at most 0.1 km, which is 0.0003 m/s². `None` when the latitude is outside ±90° or the
    /// height outside −500..=9000 m.
    ///
    /// ```
    /// use wimu_calib::Gravity;
    ///
    /// // The National Physical Laboratory in Teddington, where it is 9.8118 m/s².
    /// let teddington = Gravity::at(51.424, 10.0).expect("on Earth");
    /// assert!((teddington.mps2() - 9.8118).abs() < 2.0 * teddington.sd_mps2());
    /// ```
    pub fn at(latitude_deg: f64, height_m: f64) -> Option<Self> {
        // Of the ellipsoid: gravity at the equator, m/s², the constant of Somigliana's formula, the
        // square of the first eccentricity, semi-major axis, m, flattening, ω²a²b/GM.
        const EQUATOR_MPS2: f64 = 9.780_325_335_9;
        const K: f64 = 0.001_931_852_652_41;
        const E2: f64 = 0.006_694_379_990_13;
        const A_M: f64 = 6_378_137.0;
        const F: f64 = 1.0 / 298.257_223_563;
        const M: f64 = 0.003_449_786_506_84;
        if !((-90.0..=90.0).contains(&latitude_deg) && (-500.0..=9000.0).contains(&height_m)) {
            return None;
        }
        let sin = libm::sin(latitude_deg.to_radians());
        let s2 = sin * sin;
        let surface = EQUATOR_MPS2 * (1.0 + K * s2) / libm::sqrt(1.0 - E2 * s2);
        let h = height_m / A_M;
        let mps2 = surface * (1.0 - 2.0 * (1.0 + F + M - 2.0 * F * s2) * h + 3.0 * h * h);
        Self::new(mps2, Self::ANOMALY_MPS2)
    }

    /// Standard deviation of local from normal gravity, m/s²: anomalies of 20 to 50 mGal (1 mGal =
    /// 10⁻⁵ m/s²), larger in high mountains (Heiskanen and Moritz, Physical Geodesy, 1967).
    const ANOMALY_MPS2: f64 = 0.0005;

    /// Gravity, m/s².
    pub fn mps2(self) -> f64 {
        self.mps2
    }

    /// Its standard deviation, m/s².
    pub fn sd_mps2(self) -> f64 {
        self.sd_mps2
    }
}

impl Default for Gravity {
    fn default() -> Self {
        Self::UNKNOWN_PLACE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_gravity_is_that_of_published_values() {
        // Equator and pole: NIMA TR8350.2. 45°: Geodetic Reference System 1980, whose ellipsoid
        // differs by 10⁻⁶ m/s².
        for (latitude, height, mps2, within) in [
            (0.0, 0.0, 9.780_325_335_9, 1e-10),
            (90.0, 0.0, 9.832_184_937_8, 1e-9),
            (-90.0, 0.0, 9.832_184_937_8, 1e-9),
            (45.0, 0.0, 9.806_199_2, 2e-6),
        ] {
            let found = Gravity::at(latitude, height).expect("on Earth");
            assert!((found.mps2() - mps2).abs() < within, "{found:?}");
            assert_eq!(found.sd_mps2(), 0.0005);
        }
        // The free-air gradient at 45°: -3.0855e-6 + 1.4e-12 h per s² (Hofmann-Wellenhof, Moritz).
        let gravity = |height| Gravity::at(45.0, height).expect("on Earth").mps2();
        assert!(((gravity(1000.0) - gravity(0.0)) / 1000.0 + 3.085e-6).abs() < 1e-9);
        assert!(gravity(9000.0) < gravity(-500.0) - 0.029);
    }

    #[test]
    fn no_place_on_earth_is_refused_and_others_are() {
        for latitude in [-90.0, 0.0, 90.0] {
            for height in [-500.0, 9000.0] {
                assert!(Gravity::at(latitude, height).is_some());
            }
        }
        for (latitude, height) in
            [(90.1, 0.0), (f64::NAN, 0.0), (0.0, -501.0), (0.0, 9001.0), (0.0, f64::NAN)]
        {
            assert!(Gravity::at(latitude, height).is_none());
        }
    }
}
