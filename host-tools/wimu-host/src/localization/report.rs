//! Report of a path from ranges: that of a path, with the anchors, and the residuals of each.

use super::Localization;
use crate::chart::{Chart, Series, Style};
use crate::html::Report;

/// Innovation of a range: what the forward filter did not predict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Time, s.
    pub time_s: f64,
    /// Index of the anchor.
    pub anchor: usize,
    /// Measured minus predicted range, m.
    pub innovation_m: f64,
}

impl Localization {
    /// A page with the result of the path, its charts and `text`, that of the command.
    ///
    /// # Errors
    /// Those of [`Report`].
    pub fn page(&self, source: &str, text: &str) -> Report {
        let mut page = self.path.summary(source, text);
        let positions: Vec<_> = self.anchors.iter().map(|a| a.position_m).collect();
        let anchors = Series {
            labels: self.anchors.iter().map(|a| a.id.clone()).collect(),
            ..Series::space("anchor", Style::Dots, &positions)
        };
        let mut charts = self.path.charts(&[anchors]);
        charts.insert(1, self.innovations());
        for chart in charts {
            page.chart(&chart);
        }
        page
    }

    /// The innovations of each anchor over time.
    fn innovations(&self) -> Chart {
        let of = |index: usize| {
            let own = self.innovations.iter().filter(|i| i.anchor == index);
            own.map(|i| (i.time_s, i.innovation_m)).collect()
        };
        let series = self.anchors.iter().enumerate();
        let mut series: Vec<Series> = series
            .map(|(index, anchor)| Series::dots(&format!("anchor {}", anchor.id), of(index)))
            .collect();
        series.retain(|series| !series.points.is_empty());
        let title = "Innovation of each range: measured less predicted";
        Chart {
            note: "Predicted by the forward filter with the estimated bias and scale of the anchor. Ranges without line of sight are too long."
                .to_owned(),
            ..Chart::new(title, "time, s", "m", series)
        }
    }
}
