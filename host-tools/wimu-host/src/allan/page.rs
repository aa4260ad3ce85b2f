//! The noise of a sensor as a page: Allan deviation with its slopes.

use std::f64::consts::{LN_2, PI, SQRT_2};

use wimu_calib::Measured;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{AxisReport, Figure, NoiseReport, PointReport};
use crate::chart::{Band, Chart, Series};
use crate::digits::significant;
use crate::error::Result;
use crate::html::Report;

const AXES: [&str; 3] = ["X", "Y", "Z"];
/// µg of 1 m/s².
const UG: f64 = 1e6 / STANDARD_GRAVITY_MPS2;

impl NoiseReport {
    /// The report as a page. `datasheet_ug_rthz` is the noise density of the datasheet, µg/√Hz, if it is to be compared.
    ///
    /// # Errors
    /// `file_failed` when a picture cannot be drawn.
    pub fn page(&self, datasheet_ug_rthz: Option<f64>) -> Result<Report> {
        let mut page = Report::new(format!("Noise of {}", self.source));
        self.key_figures(&mut page, datasheet_ug_rthz);
        page.printed(&self.to_string()).findings(&self.outcome.findings);
        let mut chart = self.chart();
        if self.axes.is_some() {
            let ends = self.ends_s();
            if let Some(ug_rthz) = datasheet_ug_rthz {
                let density = ug_rthz / UG;
                let white = ends.map(|tau_s| (tau_s, density / (2.0 * tau_s).sqrt()));
                let name = format!("datasheet, {ug_rthz} µg/√Hz");
                chart.series.push(Series::line(&name, white.into()));
            }
        }
        page.chart(&chart)?;
        if !self.gyroscope_points.is_empty() {
            page.chart(&curve("gyroscope", "rad/s", &self.gyroscope_points))?;
        }
        let rows: Vec<Vec<String>> = self
            .points
            .iter()
            .map(|point| {
                let [x, y, z] = point.deviation_m_s2.map(|d| format!("{:.4}", d * 1e3));
                let share = format!("{:.1}", point.relative_sd * 100.0);
                vec![format!("{:.3}", point.tau_s), x, y, z, share]
            })
            .collect();
        let head = ["τ, s", "X, mm/s²", "Y, mm/s²", "Z, mm/s²", "± %"];
        page.table("Allan deviation", &head, &rows);
        Ok(page)
    }

    /// The Allan deviation of the accelerometer with its noise terms.
    pub fn chart(&self) -> Chart {
        let mut chart = curve("accelerometer", "m/s²", &self.points);
        if let Some(axes) = &self.axes {
            chart.series.extend(slopes(axes, self.ends_s()));
        }
        chart
    }

    /// The shortest and the longest averaging time, s.
    fn ends_s(&self) -> [f64; 2] {
        let ends = [self.points.first(), self.points.last()];
        ends.map(|point| point.map_or(1.0, |point| point.tau_s))
    }

    fn key_figures(&self, page: &mut Report, datasheet_ug_rthz: Option<f64>) {
        let Some(axes) = &self.axes else {
            page.result(&self.outcome.to_string());
            return;
        };
        let each = |of: &dyn Fn(&AxisReport) -> Option<f64>| {
            let one = |axis| of(axis).map_or("–".to_owned(), |value| significant(value, 3));
            axes.each_ref().map(one).join(", ")
        };
        let density = |axis: &AxisReport| axis.noise_density_m_s2_rthz.value * UG;
        let mut result = format!(
            "{} s at rest, {} Hz: noise density {} µg/√Hz (X, Y, Z).",
            significant(self.samples as f64 / self.rate_hz, 3),
            significant(self.rate_hz, 3),
            each(&|axis| Some(density(axis)))
        );
        if let Some(stated) = datasheet_ug_rthz {
            let ratio = each(&|axis| Some(density(axis) / stated));
            result += &format!(" That is {ratio} times the datasheet's {stated} µg/√Hz.");
        }
        page.result(&result);
        let walk = |axis: &AxisReport| Some(axis.velocity_random_walk_m_s_rts.value * 1e3);
        let bias = |axis: &AxisReport| Some(axis.bias_instability_m_s2?.value * UG);
        page.key("noise density, µg/√Hz", &each(&|axis| Some(density(axis))))
            .key("velocity random walk, mm/s/√s", &each(&walk));
        if axes.iter().any(|axis| axis.bias_instability_m_s2.is_some()) {
            page.key("bias instability, µg", &each(&bias));
        } else {
            let floor = each(&|axis| Some(axis.floor_m_s2 * UG));
            page.key("smallest deviation, µg", &floor);
        }
    }
}

/// Allan deviation of three axes with its band of 95 %.
fn curve(sensor: &str, unit: &str, points: &[PointReport]) -> Chart {
    let band = |axis: usize| {
        let points = points.iter().map(|point| {
            let value = point.deviation_m_s2[axis];
            let sd = value * point.relative_sd;
            let [low, high] = Figure::from(Measured { value, sd }).interval_95;
            (point.tau_s, low, high)
        });
        Band { series: axis, points: points.collect() }
    };
    let line = |axis: usize| {
        let points = points.iter().map(|p| (p.tau_s, p.deviation_m_s2[axis]));
        Series::line(AXES[axis], points.collect())
    };
    let title = format!("Allan deviation of the {sensor}, with its 95 % band");
    let series = [0, 1, 2].map(line).into();
    Chart {
        log_x: true,
        log: true,
        bands: [0, 1, 2].map(band).into(),
        ..Chart::new(title, "averaging time τ, s", unit, series)
    }
}

/// A term of the noise at an averaging time.
type Term<'a> = &'a dyn Fn(&AxisReport, f64) -> Option<f64>;

/// The slopes of the noise terms in the geometric mean of the axes, over these averaging times, s. Without a bias
/// instability the level of the smallest deviation is shown, without a random walk a line through its end.
fn slopes(axes: &[AxisReport; 3], ends_s: [f64; 2]) -> Vec<Series> {
    let white: Term<'_> =
        &|axis, tau_s| Some(axis.noise_density_m_s2_rthz.value / (SQRT_2 * tau_s.sqrt()));
    let bias: Term<'_> = &|axis, _| {
        let factor = (2.0 * LN_2 / PI).sqrt();
        Some(factor * axis.bias_instability_m_s2?.value)
    };
    let floor: Term<'_> = &|axis, _| Some(axis.floor_m_s2);
    let walk: Term<'_> = &|axis, tau_s| {
        let density = axis.acceleration_random_walk_m_s2_rts?.value;
        Some(density * (tau_s / 3.0).sqrt())
    };
    let from_floor: Term<'_> = &|axis, tau_s| Some(axis.floor_m_s2 * (tau_s / ends_s[1]).sqrt());
    let terms: [(&str, Term<'_>, &str, Term<'_>); 3] = [
        ("slope −½: white noise", white, "", white),
        ("slope 0: bias instability", bias, "slope 0: smallest deviation", floor),
        ("slope +½: random walk", walk, "slope +½, for comparison", from_floor),
    ];
    let mean = |term: Term<'_>, tau_s: f64| {
        let found: Vec<f64> = axes.iter().filter_map(|axis| term(axis, tau_s)).collect();
        let logs = found.iter().map(|value| value.ln()).sum::<f64>();
        (!found.is_empty()).then(|| (logs / found.len() as f64).exp())
    };
    let line = |(name, term, instead, otherwise): (&str, Term<'_>, &str, Term<'_>)| {
        let is_found = mean(term, 1.0).is_some();
        let (name, term) = if is_found { (name, term) } else { (instead, otherwise) };
        let points = ends_s.map(|tau_s| (tau_s, mean(term, tau_s).unwrap_or(f64::NAN)));
        Series::guide(name, points.into())
    };
    terms.map(line).into()
}
