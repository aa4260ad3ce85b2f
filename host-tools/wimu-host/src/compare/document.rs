//! Comparisons as documents.

use super::{Alignment, Axis, Comparison, LinkReport};
use crate::digits::{signed_with_sd, significant, with_sd};
use crate::document::{Document, ToDocument};

const AXES: [&str; 3] = ["X", "Y", "Z"];

impl ToDocument for Comparison {
    fn document(&self) -> Document {
        let mut document = Document::new(format!("Wireless against cable: {}", self.source));
        document.result(&self.result());
        let wireless = &self.links[1];
        let lost = wireless.lost as f64 / (wireless.delivered + wireless.lost).max(1) as f64;
        let lost = format!("{} ({} %)", wireless.lost, significant(100.0 * lost, 2));
        document.key("wireless samples lost", &lost);
        self.deliveries(&mut document);
        self.latencies(&mut document);
        for link in &self.links {
            link.details(&mut document);
        }
        if let Some(clock) = &self.clock {
            document.key("clock from both links", &clock.to_string());
        }
        if let Some(values) = &self.values {
            axes(&mut document, "Values of wireless against cable (± is 1 σ)", &values.axes);
        }
        document.findings(&self.findings);
        for chart in &self.charts() {
            document.chart(chart);
        }
        document
    }
}

impl Comparison {
    fn result(&self) -> String {
        let identical = match self.identical {
            all if all == self.pairs => "all".to_owned(),
            some => some.to_string(),
        };
        let mut text = format!(
            "{}: {:.1} s, {} {} samples on both links, {identical} of them identical",
            self.source, self.duration_s, self.pairs, self.stream
        );
        match (self.with_rates, self.rates_differ) {
            (0, 0) => {}
            (with, 0) => text += &format!(", {with} with equal angular rates"),
            (with, differ) => text += &format!(", {differ} of {with} angular rates differ"),
        }
        if self.starts != 1 {
            text += &format!("; {} starts of the board", self.starts);
        }
        text
    }

    /// What each link delivered.
    fn deliveries(&self, document: &mut Document) {
        let count =
            |of: fn(&LinkReport) -> u64| self.links.each_ref().map(|link| of(link).to_string());
        let shed = self.links.each_ref().map(|link| link.shed);
        let shed = shed.map(|shed| shed.map_or("unknown".to_owned(), |shed| shed.to_string()));
        let rows = [
            ("delivered", count(|link| link.delivered)),
            ("lost", count(|link| link.lost)),
            ("lost on both links", count(|link| link.missing_on_both)),
            ("duplicated", count(|link| link.duplicated)),
            ("delayed", count(|link| link.late)),
            ("damaged frames", count(|link| link.damaged)),
            ("frames dropped by the board", shed),
            ("batches without a time reference", count(|link| link.unplaced)),
            ("frames rejected (impossible number or time)", count(|link| link.rejected)),
            ("interruptions", count(|link| link.interruptions)),
        ];
        self.by_link(document, "Samples", &rows);
    }

    /// How late and how fast each link was.
    fn latencies(&self, document: &mut Document) {
        let number = |digits: usize, of: fn(&LinkReport) -> f64| {
            self.links.each_ref().map(|link| format!("{:.digits$}", of(link)))
        };
        let rows = [
            ("latency, median, ms", number(1, |link| link.latency.median_ms)),
            ("latency, 95 %, ms", number(1, |link| link.latency.p95_ms)),
            ("latency, 99 %, ms", number(1, |link| link.latency.p99_ms)),
            ("latency, maximum, ms", number(1, |link| link.latency.max_ms)),
            ("jitter, ms", number(1, |link| link.jitter_ms)),
            ("samples/s", number(1, |link| link.samples_per_s)),
            ("bytes/s", number(0, |link| link.bytes_per_s)),
            ("open, s", number(1, |link| link.open_s)),
        ];
        self.by_link(document, "Latency and rate", &rows);
    }

    /// A table with a column for each link.
    fn by_link(&self, document: &mut Document, name: &str, rows: &[(&str, [String; 2])]) {
        let row = |(quantity, [cable, wireless]): &(&str, [String; 2])| {
            vec![(*quantity).to_owned(), cable.clone(), wireless.clone()]
        };
        let [cable, wireless] = self.links.each_ref().map(|link| link.link.as_str());
        document.table(name, &["", cable, wireless], &Vec::from_iter(rows.iter().map(row)));
    }
}

impl LinkReport {
    /// What the tables do not have.
    fn details(&self, document: &mut Document) {
        let mut add = |what: &str, text: &str| {
            document.key(&format!("{} {what}", self.link), text);
        };
        if self.before + self.under_way > 0 {
            let text = format!(
                "{} before its first, {} possibly in transit at the end",
                self.before, self.under_way
            );
            add("samples of the other link", &text);
        }
        let runs = self.bursts.iter().map(|burst| match burst.to - burst.from {
            0 => format!("{} × {}", burst.runs, burst.from),
            _ => format!("{} × {}-{}", burst.runs, burst.from, burst.to),
        });
        if !self.bursts.is_empty() {
            add("runs of missing samples", &Vec::from_iter(runs).join(", "));
        }
        if let Some(clock) = &self.clock {
            add("clock", &clock.to_string());
        }
        if let Some(user) = &self.by_arrival {
            let text = format!(
                "{:.1} mm/s² rms, {:.1} mm/s² after subtracting the median latency",
                user.rms_mps2 * 1e3,
                user.rms_without_latency_mps2 * 1e3
            );
            add("error if resampled by arrival time", &text);
        }
    }
}

impl ToDocument for Alignment {
    fn document(&self) -> Document {
        let [reference, other] = &self.sources;
        let mut document = Document::new(format!("{other} against {reference}"));
        document.result(&format!(
            "{other} against {reference}: {:.1} s in common at {:.1} Hz, correlation of the magnitudes {:.3}",
            self.overlap_s, self.rate_hz, self.correlation
        ));
        document.key("clock offset, s", &signed_with_sd(self.offset_s, self.offset_sd_s));
        if let (Some(ppm), Some(sd)) = (self.rate_ppm, self.rate_sd_ppm) {
            let side = if ppm > 0.0 { "slow" } else { "fast" };
            document.key("clock rate, ppm", &format!("{} {side}", with_sd(ppm.abs(), sd)));
        }
        if let Some(turn) = &self.turn {
            let angle = with_sd(turn.angle_deg, turn.angle_sd_deg);
            document.key("rotation of its axes from the reference's, °", &angle);
        }
        if let Some(found) = &self.axes {
            axes(&mut document, "Values along its own axes (± is 1 σ)", found);
        }
        document.findings(&self.findings);
        document
    }
}

/// The values of each axis.
fn axes(document: &mut Document, name: &str, axes: &[Axis; 3]) {
    let rows = axes.iter().zip(AXES).map(|(axis, name)| {
        let offset = signed_with_sd(axis.offset_mps2, axis.offset_sd_mps2);
        let [bias, scale] = match &axis.line {
            Some(line) => [
                signed_with_sd(line.bias_mps2, line.bias_sd_mps2),
                with_sd(line.scale, line.scale_sd),
            ],
            None => [format!("{offset} (offset)"), "too little motion".to_owned()],
        };
        let most = axis.max_before_lsb.map_or("–".to_owned(), |lsb| lsb.to_string());
        let [before, after] =
            [axis.rms_before_mps2, axis.rms_after_mps2].map(|mps2| format!("{:.2}", mps2 * 1e3));
        vec![name.to_owned(), bias, scale, before, most, after]
    });
    let [before, after] = ["difference, mm/s² rms", "residual, mm/s² rms"];
    let head = ["axis", "bias, m/s²", "scale factor", before, "most, LSB", after];
    document.table(name, &head, &Vec::from_iter(rows));
}
