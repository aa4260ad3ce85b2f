//! One recording of an entry: its files, and the path by each estimator.

use std::fs;
use std::path::Path;

use nalgebra::Vector3;

use crate::baseline::{ranges, zupt};
use crate::command::{Point, Ran, points, run};
use crate::manifest::{Entry, Source};
use crate::table::{Result, Table};
use crate::truth::Truth;

/// Windows are scored until this time after their start, s.
pub const WINDOW_S: f64 = 5.0;

pub struct Case<'a> {
    pub entry: &'a Entry,
    /// Relative to the data, as all files of the entry.
    pub recording: &'a str,
    pub data: &'a Path,
    /// For files that are written.
    pub folder: &'a Path,
    /// Number of simulated journeys.
    pub journeys: u64,
}

impl<'a> Case<'a> {
    /// A table of the data without its truth and the columns that the entry and the estimator delete.
    pub fn table(&self, file: &str, source: Source) -> Result<Table> {
        let mut table = Table::read(&self.data.join(file))?;
        table.delete(&["Truth".to_owned()]);
        table.delete(&self.entry.delete);
        if source == Source::ColumnsDeleted {
            table.delete(&["Magnetometer".to_owned()]);
        }
        Ok(table)
    }

    /// Writes a table and gives its file as an argument.
    pub fn file(&self, name: &str, table: &Table) -> Result<String> {
        let file = self.folder.join(name);
        fs::write(&file, table.text())?;
        Ok(file.display().to_string())
    }

    /// Runs `wimu navigate` on tables with the options and aids of the entry; reads what it writes under a name.
    pub fn navigate(&self, inputs: &[Table], extra: &[&str], name: &str) -> Result<Ran> {
        let mut arguments = vec!["navigate".to_owned()];
        for (k, input) in inputs.iter().enumerate() {
            arguments.push(self.file(&format!("recording-{k}.csv"), input)?);
        }
        arguments.extend(self.entry.options.iter().cloned());
        for [option, file] in &self.entry.aids {
            let file = self.data.join(file).display().to_string();
            if option.ends_with('=') {
                arguments.push(format!("{option}{file}"));
            } else {
                arguments.extend([option.clone(), file]);
            }
        }
        let output = self.folder.join("path.csv");
        let output_name = output.display().to_string();
        arguments.extend(extra.iter().chain(&["-o", &output_name]).map(|&word| word.to_owned()));
        let mut ran = run(&arguments, self.folder)?;
        if ran.exit == 0 {
            ran.points = points(&output, name)?;
        }
        Ok(ran)
    }

    pub fn truth_file(&self) -> &str {
        self.entry.truth.as_deref().unwrap_or(self.recording)
    }

    /// The truth; that of a file without such columns is its path by the command.
    pub fn truth(&self) -> Result<Truth<'a>> {
        if let Some(truth) = Truth::read(&self.data.join(self.truth_file()), self.entry)? {
            return Ok(truth);
        }
        let ran = self.navigate(&[self.table(self.truth_file(), Source::Command)?], &[], "")?;
        Ok(Truth::new(ran.points, self.entry))
    }

    /// The path by an estimator, which gets the truth until each of `starts`, s.
    pub fn path(&self, source: Source, truth: &Truth, starts: &[f64]) -> Result<Ran> {
        let table = self.table(self.recording, source)?;
        let points = match source {
            Source::Command | Source::ColumnsDeleted if starts.is_empty() => {
                return self.navigate(&[table], &[], "");
            }
            Source::Command | Source::ColumnsDeleted => {
                let fixes = self.file("fixes.csv", &truth.fixes(starts))?;
                return self.navigate(&[table], &["--fixes", &fixes], "");
            }
            Source::ZuptHand => zupt::path(&table, &zupt::HAND, truth, starts)?,
            Source::ZuptFoot => zupt::path(&table, &zupt::FOOT, truth, starts)?,
            Source::Stays if starts.is_empty() => {
                table.times()?.into_iter().map(|t| Point::new(t, Vector3::zeros())).collect()
            }
            Source::Stays => {
                let ends = starts.iter().flat_map(|start_s| [0.0, WINDOW_S].map(|t| (start_s, t)));
                let point = |(start_s, t): (&f64, f64)| {
                    Some(Point::new(start_s + t, truth.position(*start_s)?))
                };
                ends.filter_map(point).collect()
            }
            Source::LeastSquares => ranges::least_squares(&self.ranges(&table)?),
            Source::ConstantVelocity => ranges::constant_velocity(&self.ranges(&table)?),
            _ => return Err(format!("{source:?} estimates no path").into()),
        };
        Ok(Ran { points, ..Ran::default() })
    }

    fn ranges(&self, recording: &Table) -> Result<Vec<ranges::Range>> {
        let aid = |option: &str| {
            let aid = self.entry.aids.iter().find(|aid| aid[0] == option);
            aid.map(|aid| Table::read(&self.data.join(&aid[1]))).transpose()
        };
        let anchors = aid("--setup=anchors=")?.ok_or("no anchors among the aids")?;
        ranges::read(aid("--ranges")?.as_ref().unwrap_or(recording), anchors)
    }
}
