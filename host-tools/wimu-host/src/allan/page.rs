//! The noise of a sensor as a page: Allan deviation with its slopes.

use std::f64::consts::{LN_2, PI};

use wimu_calib::{AxisNoise, Measured};

use super::sensor::{SensorNoise, UG};
use super::{Figure, NoiseReport};
use crate::chart::{Band, Chart, Series};
use crate::digits::significant;
use crate::html::Report;

const AXES: [&str; 3] = ["X", "Y", "Z"];

impl NoiseReport {
    /// The report as a page. `datasheet_ug_rthz` is the noise density of the datasheet, µg/√Hz, if it is to be compared.
    pub fn page(&self, datasheet_ug_rthz: Option<f64>) -> Report {
        let mut page = Report::new(format!("Noise of {}", self.source));
        if self.measured().next().is_none() {
            page.result(&self.outcome.to_string());
        }
        for sensor in self.measured() {
            let stated = datasheet_ug_rthz.filter(|_| sensor.kind.si == "m/s²");
            self.key_figures(sensor, &mut page, stated);
        }
        page.printed(&self.to_string()).findings(&self.outcome.findings);
        for sensor in self.measured() {
            let mut chart = sensor.chart();
            if let Some(ug_rthz) = datasheet_ug_rthz.filter(|_| sensor.kind.si == "m/s²") {
                let density = ug_rthz / UG;
                let white = sensor.ends_s().map(|tau_s| (tau_s, density / (2.0 * tau_s).sqrt()));
                let name = format!("datasheet, {ug_rthz} µg/√Hz");
                chart.series.push(Series::line(&name, white.into()));
            }
            page.chart(&chart);
            let unit = &sensor.kind.deviation;
            let rows: Vec<Vec<String>> = sensor
                .points
                .iter()
                .map(|point| {
                    let deviations = point.deviation_m_s2.map(|d| significant(d * unit.per_si, 4));
                    let share = format!("{:.1}", point.relative_sd * 100.0);
                    let [x, y, z] = deviations;
                    vec![format!("{:.3}", point.tau_s), x, y, z, share]
                })
                .collect();
            let axes = AXES.map(|axis| format!("{axis}, {}", unit.name));
            let head = ["τ, s", &axes[0], &axes[1], &axes[2], "± %"];
            page.table(&format!("Allan deviation of the {}", sensor.kind.name), &head, &rows);
        }
        page
    }

    fn key_figures(&self, sensor: &SensorNoise, page: &mut Report, stated: Option<f64>) {
        let each = |of: &dyn Fn(&AxisNoise) -> Option<f64>| {
            let one = |axis| of(axis).map_or("–".to_owned(), |value| significant(value, 3));
            sensor.axes.each_ref().map(one).join(", ")
        };
        let kind = sensor.kind;
        let density = |axis: &AxisNoise| axis.noise_density().value * kind.density.per_si;
        let mut result = format!(
            "{}: {} s at rest, {} Hz: noise density {} {} (X, Y, Z).",
            kind.name,
            significant(self.samples as f64 / self.rate_hz, 3),
            significant(self.rate_hz, 3),
            each(&|axis| Some(density(axis))),
            kind.density.name
        );
        if let Some(stated) = stated {
            let ratio = each(&|axis| Some(density(axis) / stated));
            result += &format!(" That is {ratio} times the datasheet's {stated} µg/√Hz.");
        }
        page.result(&result);
        let (white_name, white) = &kind.white;
        let walk = |axis: &AxisNoise| Some(axis.velocity_random_walk.value * white.per_si);
        page.key(&format!("noise density, {}", kind.density.name), &each(&|a| Some(density(a))))
            .key(&format!("{white_name}, {}", white.name), &each(&walk));
        let (per_si, unit) = (kind.bias.per_si, kind.bias.name);
        if sensor.axes.iter().any(|axis| axis.bias_instability_mps2.is_some()) {
            let bias = |axis: &AxisNoise| Some(axis.bias_instability_mps2?.value * per_si);
            page.key(&format!("bias instability, {unit}"), &each(&bias));
        } else {
            let floor = each(&|axis| Some(axis.floor_mps2 * per_si));
            page.key(&format!("smallest deviation, {unit}"), &floor);
        }
    }

    /// The Allan deviation of the first sensor with its noise terms.
    pub fn chart(&self) -> Option<Chart> {
        self.measured().next().map(SensorNoise::chart)
    }
}

impl SensorNoise {
    /// The shortest and the longest averaging time, s.
    fn ends_s(&self) -> [f64; 2] {
        let ends = [self.points.first(), self.points.last()];
        ends.map(|point| point.map_or(1.0, |point| point.tau_s))
    }

    /// The Allan deviation of the axes with its band of 95 %, and its noise terms.
    fn chart(&self) -> Chart {
        let points = &self.points;
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
        let title = format!("Allan deviation of the {}, with its 95 % band", self.kind.name);
        let mut series = Vec::from([0, 1, 2].map(line));
        series.extend(slopes(&self.axes, self.ends_s()));
        Chart {
            log_x: true,
            log: true,
            bands: [0, 1, 2].map(band).into(),
            ..Chart::new(title, "averaging time τ, s", self.kind.si, series)
        }
    }
}

/// A term of the noise at an averaging time.
type Term<'a> = &'a dyn Fn(&AxisNoise, f64) -> Option<f64>;

/// The slopes of the noise terms in the geometric mean of the axes, over these averaging times, s. Without a bias
/// instability the level of the smallest deviation is shown, without a random walk a line through its end.
fn slopes(axes: &[AxisNoise; 3], ends_s: [f64; 2]) -> Vec<Series> {
    let white: Term<'_> = &|axis, tau_s| Some(axis.velocity_random_walk.value / tau_s.sqrt());
    let bias: Term<'_> = &|axis, _| {
        let factor = (2.0 * LN_2 / PI).sqrt();
        Some(factor * axis.bias_instability_mps2?.value)
    };
    let floor: Term<'_> = &|axis, _| Some(axis.floor_mps2);
    let walk: Term<'_> = &|axis, tau_s| {
        let density = axis.acceleration_random_walk?.value;
        Some(density * (tau_s / 3.0).sqrt())
    };
    let from_floor: Term<'_> = &|axis, tau_s| Some(axis.floor_mps2 * (tau_s / ends_s[1]).sqrt());
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
