//! Height by the pressure of the air, above an unknown height that drifts with the weather.

use nalgebra::{Matrix1, RowVector3};
use wimu_nav::filter::Filter;
use wimu_nav::sensor::{Measurement, Prediction};
use wimu_nav::state::{Block, POSITION};

use super::{Kind, State};

/// Pressure at sea level, Pa; height at which it would be zero, m, and exponent (ICAO Doc 7488, standard atmosphere).
const SEA_LEVEL_PA: f64 = 101_325.0;
const SCALE_M: f64 = 44_330.8;
const EXPONENT: f64 = 0.190_263;

/// Pressure of the air. Usual σ: noise of a MEMS barometer, 3 Pa (BMP280 datasheet: 1.3 Pa) and gusts. The height of the origin
/// is within 2 km of that of the standard atmosphere; 1 hPa an hour of weather is 8 m.
pub static PRESSURE: Kind = Kind {
    name: "pressure",
    one: "pressure",
    columns: &[&["Pressure"]],
    unit: &[(1.0, "Pa"), (100.0, "hPa mbar"), (1000.0, "kPa")],
    // Range of the BMP280: 9 km above sea level to 0.7 km below.
    range: [30e3, 110e3],
    usual_sd: Some(3.0),
    states: &[State { name: "height of the origin", unit: "m", sd: 2000.0, walk: 0.15 }],
    remedy: "check that the vent of the barometer is open and not in a draught",
    update: |aid, to| {
        let (height_m, m_per_pa) = height(aid.value[0]);
        to.with(Height { height_m, deviation_m: aid.sd[0] * m_per_pa, origin: to.states[0] })
    },
    ..Kind::DEFAULT
};

/// Height of a pressure, Pa, in the standard atmosphere, m, and metres per pascal.
fn height(pressure_pa: f64) -> (f64, f64) {
    let ratio = (pressure_pa.max(1.0) / SEA_LEVEL_PA).powf(EXPONENT);
    (SCALE_M * (1.0 - ratio), SCALE_M * EXPONENT * ratio / pressure_pa.max(1.0))
}

/// A height above that of the origin.
struct Height {
    height_m: f64,
    deviation_m: f64,
    origin: Block<1>,
}

impl Measurement for Height {
    fn predict(&self, filter: &Filter) -> Prediction {
        let shown = filter.state.get(POSITION).z + filter.state.get(self.origin).x;
        let noise = self.deviation_m * self.deviation_m;
        Prediction::new(Matrix1::new(self.height_m - shown), Matrix1::new(noise))
            .by(POSITION, RowVector3::new(0.0, 0.0, 1.0))
            .by(self.origin, Matrix1::new(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::height;

    #[test]
    fn heights_are_those_of_the_standard_atmosphere() {
        // ICAO Doc 7488: 1000 m at 898.746 hPa.
        let (height_m, m_per_pa) = height(89_874.6);
        assert!((height_m - 1000.0).abs() < 0.2, "{height_m}");
        assert!((m_per_pa - 0.0917).abs() < 1e-3, "{m_per_pa}");
    }
}
