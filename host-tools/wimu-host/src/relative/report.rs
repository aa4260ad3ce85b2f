//! The result as text, CSV and a chart.

use std::io::BufWriter;
use std::path::Path;

use super::{RelativePath, RelativePoint};
use crate::chart::{Band, Chart, Series, broken};
use crate::csv::CsvWriter;
use crate::document::Document;
use crate::stats::median;
use crate::{OutputFile, Result};

impl RelativePath {
    /// The valid points.
    pub fn valid(&self) -> impl DoubleEndedIterator<Item = &RelativePoint> {
        self.points.iter().filter(|point| point.valid)
    }

    /// Median standard deviation of the angle, rad.
    pub fn median_sigma_rad(&self) -> f64 {
        median(self.valid().map(|point| point.sigma_rad)).unwrap_or(f64::NAN)
    }

    /// Least and largest angle, rad.
    pub fn range_rad(&self) -> [f64; 2] {
        let angles = || self.valid().map(|point| point.angle_rad);
        [angles().fold(f64::INFINITY, f64::min), angles().fold(f64::NEG_INFINITY, f64::max)]
    }

    /// The result first, then what it rests on.
    pub fn text(&self) -> String {
        let Some(last) = self.valid().next_back() else {
            return "angle: not known".to_owned();
        };
        let deg = f64::to_degrees;
        let [least, most] = self.range_rad().map(deg);
        let mut text = format!(
            "angle: {:+.1}° ± {:.1}° at {:.2} s (the end); {least:+.1}° to {most:+.1}°, ± {:.1}° (1 σ, median)\n",
            deg(last.angle_rad),
            deg(last.sigma_rad),
            last.time_s,
            deg(self.median_sigma_rad())
        );
        let [w, x, y, z] = last.quaternion;
        text += &format!(
            "rotation of B relative to A at the end: {w:+.4} {x:+.4} {y:+.4} {z:+.4} (quaternion W X Y Z)\n"
        );
        let origin = if self.hinge.given { "given" } else { "found" };
        for (k, unit) in ["A", "B"].into_iter().enumerate() {
            let [x, y, z] = self.hinge.axes[k];
            let arm = self.lever_arms_m[k];
            text += &format!(
                "{unit}: hinge axis {x:+.3} {y:+.3} {z:+.3} ± {:.1}° ({origin}); joint about {:+.2} {:+.2} {:+.2} m from it\n",
                deg(self.hinge.sd_rad[k]),
                arm[0],
                arm[1],
                arm[2]
            );
        }
        let clock = &self.clock;
        text += &format!(
            "clock: {:+.3} s added to the times of B, ± {:.1} ms\n",
            clock.offset_s,
            1e3 * clock.sd_s
        );
        text
    }

    /// Writes one row for each point.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write(&self, file: &Path) -> Result<()> {
        let (output, sink) = OutputFile::create(file)?;
        let mut columns =
            ["Time (s)", "Angle (deg)", "Angle Sigma (deg)"].map(str::to_owned).to_vec();
        columns.extend(["W", "X", "Y", "Z"].map(|axis| format!("Quaternion {axis}")));
        columns.extend(["X", "Y", "Z"].map(|axis| format!("Attitude Sigma {axis} (deg)")));
        columns.push("Valid".to_owned());
        let mut out = CsvWriter::new(BufWriter::new(sink), output.name(), &columns)?;
        for point in &self.points {
            out.field(format!("{:.6}", point.time_s));
            out.vector(Some([point.angle_rad, point.sigma_rad].map(f64::to_degrees)));
            out.vector(Some(point.quaternion));
            out.vector(Some(point.attitude_sd_rad.map(f64::to_degrees)));
            out.field(u8::from(point.valid)).end_row()?;
        }
        out.finish()?;
        output.finish()
    }

    /// A page with the result and its chart; `text` is that of the command.
    ///
    /// # Errors
    /// Those of [`Document`].
    pub fn page(&self, source: &str, text: &str) -> Document {
        let mut page = Document::new(format!("Angle between {source}"));
        page.result(text.lines().next().unwrap_or_default());
        page.key("hinge axis, 1 σ", &format!("± {:.1}°", self.hinge.worst_sd_rad().to_degrees()));
        page.key("angle, 1 σ, median", &format!("± {:.1}°", self.median_sigma_rad().to_degrees()));
        page.printed(text).findings(&self.findings);
        page.chart(&self.angle());
        page
    }

    /// The angle with its 2 σ band.
    pub fn angle(&self) -> Chart {
        let of = |value: &dyn Fn(&RelativePoint) -> f64| {
            self.valid().map(|point| (point.time_s, value(point).to_degrees())).collect()
        };
        let [low, high]: [Vec<(f64, f64)>; 2] =
            [-2.0, 2.0].map(|k| of(&|p| p.angle_rad + k * p.sigma_rad));
        let band = low.into_iter().zip(high).map(|((t, low), (_, high))| (t, low, high));
        let series = vec![Series::line("angle", broken(of(&|p| p.angle_rad)))];
        Chart {
            bands: vec![Band { series: 0, points: band.collect() }],
            note: "Band: 2 σ. Zero: axes of units that are mounted alike are parallel.".to_owned(),
            ..Chart::new("Angle of the hinge", "time, s", "deg", series)
        }
    }
}
