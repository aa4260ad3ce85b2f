//! The noise of a sensor as a document: noise terms of each axis, and the Allan deviation with its slopes.

use std::f64::consts::{LN_2, PI};

use wimu_calib::Measured;

use super::sensor::Kind;
use super::{AxisNoise, Figure, NoiseReport, SensorNoise};
use crate::chart::{Band, Chart, Series};
use crate::digits::significant;
use crate::document::{Document, ToDocument};

const AXES: [&str; 3] = ["X", "Y", "Z"];

impl ToDocument for NoiseReport {
    fn document(&self) -> Document {
        let mut document = Document::new(format!("Noise of {}", self.source));
        let seconds = self.samples as f64 / self.rate_hz;
        let [seconds, rate] = [seconds, self.rate_hz].map(|value| significant(value, 4));
        document.result(&format!("{}: {seconds} s at rest, {rate} Hz", self.source));
        if self.measured().next().is_none() {
            document.result(&self.outcome.to_string());
        }
        for sensor in self.measured() {
            sensor.terms(&mut document);
            document.chart(&sensor.chart());
            sensor.curve(&mut document);
        }
        document.findings(&self.outcome.findings);
        document
    }
}

impl NoiseReport {
    /// The Allan deviation of the first sensor with its noise terms.
    pub fn chart(&self) -> Option<Chart> {
        self.measured().next().map(SensorNoise::chart)
    }
}

impl SensorNoise {
    /// The noise terms of each axis.
    fn terms(&self, document: &mut Document) {
        let Kind { density, white, walk, bias, .. } = self.kind;
        let columns = [
            ("noise density", density),
            (white.0, &white.1),
            ("bias instability", bias),
            (walk.0, &walk.1),
        ];
        let head = columns.map(|(name, unit)| format!("{name}, {}", unit.name));
        let mut head: Vec<&str> = head.iter().map(String::as_str).collect();
        head.insert(0, self.kind.name);
        let rows = self.axes.iter().zip(AXES).map(|(axis, name)| {
            let floor =
                format!("σ falls to {} at {:.0} s", bias.number(axis.floor), axis.floor_tau_s);
            let cell = |found: Option<Figure>, column: usize| {
                found.map_or("–".to_owned(), |found| columns[column].1.text(found))
            };
            vec![
                name.to_owned(),
                cell(Some(axis.noise_density), 0),
                cell(Some(axis.random_walk), 1),
                axis.bias_instability.map_or(floor, |found| bias.text(found)),
                cell(axis.bias_random_walk, 3),
            ]
        });
        let name = format!("Noise of the {} (density one-sided)", self.kind.name);
        document.table(&name, &head, &Vec::from_iter(rows));
    }

    /// The Allan deviation as a table.
    fn curve(&self, document: &mut Document) {
        let unit = &self.kind.deviation;
        let rows = self.points.iter().map(|point| {
            let [x, y, z] = point.deviation.map(|d| significant(d * unit.per_si, 4));
            let share = format!("{:.1}", point.relative_sd * 100.0);
            vec![format!("{:.3}", point.tau_s), x, y, z, share]
        });
        let axes = AXES.map(|axis| format!("{axis}, {}", unit.name));
        let head = ["τ, s", &axes[0], &axes[1], &axes[2], "± %"];
        let name = format!("Allan deviation of the {}", self.kind.name);
        document.table(&name, &head, &Vec::from_iter(rows));
    }

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
                let value = point.deviation[axis];
                let sd = value * point.relative_sd;
                let [low, high] = Measured { value, sd }.interval_95();
                (point.tau_s, low, high)
            });
            Band { series: axis, points: points.collect() }
        };
        let line = |axis: usize| {
            let points = points.iter().map(|p| (p.tau_s, p.deviation[axis]));
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
    let white: Term<'_> = &|axis, tau_s| Some(axis.random_walk.value / tau_s.sqrt());
    let bias: Term<'_> = &|axis, _| {
        let factor = (2.0 * LN_2 / PI).sqrt();
        Some(factor * axis.bias_instability?.value)
    };
    let floor: Term<'_> = &|axis, _| Some(axis.floor);
    let walk: Term<'_> = &|axis, tau_s| {
        let density = axis.bias_random_walk?.value;
        Some(density * (tau_s / 3.0).sqrt())
    };
    let from_floor: Term<'_> = &|axis, tau_s| Some(axis.floor * (tau_s / ends_s[1]).sqrt());
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
