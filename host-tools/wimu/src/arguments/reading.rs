//! How recordings are read: options that several commands share.

use std::str::FromStr;

use clap::Args;
use wimu_host::csv::Filter;
use wimu_host::formats::ReadOptions;
use wimu_link::LinkRole;

#[derive(Args)]
#[command(next_help_heading = "Reading FILE")]
pub struct Reading {
    /// Rows of a table to use: those whose columns have these values, such as "Run=2,IMU=0"
    #[arg(hide_short_help = true, long = "where", value_name = "COLUMN=VALUE,…")]
    pub filter: Option<Filter>,
    /// Format of the file, by its name in docs/reference/formats.md [default: detected by its content]
    #[arg(hide_short_help = true, long, value_name = "NAME")]
    pub format: Option<String>,
    /// Topic, message or log to read, where the file has several; of a recording of wimu the link: cable or wireless
    /// [default: the cable if it was recorded]
    #[arg(hide_short_help = true, long, value_name = "NAME")]
    pub topic: Option<String>,
    /// Columns of a table, by header or by number from 1, with units: "t=timestamp:ns,x=ax:g,y=ay:g,z=az:g"
    #[arg(hide_short_help = true, long, value_name = "LIST")]
    pub columns: Option<String>,
    /// Units instead of those of the file: of accelerations m/s2, g, mg, mm/s2 or LSB, of rates rad/s or deg/s: g,deg/s.
    /// LSB@32768: counts whose zero is 32768 [default: detected]
    #[arg(hide_short_help = true, long, value_name = "UNIT")]
    pub units: Option<Units>,
    /// Sample rate of a table, Hz, instead of its times
    #[arg(hide_short_help = true, long, value_name = "HZ", value_parser = super::from_to(1e-3, 1e6))]
    pub rate: Option<f64>,
}

impl Reading {
    /// The same for the library; `poses` if the rows of a table are means over static poses.
    pub fn options(&self, poses: bool) -> ReadOptions {
        let mut options = ReadOptions::default();
        options.format = self.format.clone();
        options.topic = self.topic.clone();
        options.columns = self.columns.clone();
        options.units = self.units.as_ref().and_then(|units| units.names.clone());
        options.rate_hz = self.rate;
        options.zero_count = self.units.as_ref().and_then(|units| units.zero_count);
        options.filter = self.filter.clone();
        options.role = self.role();
        options.poses = poses;
        options
    }

    /// The link of a recording of wimu that the topic names.
    pub fn role(&self) -> Option<LinkRole> {
        match self.topic.as_deref() {
            Some("cable") => Some(LinkRole::Cable),
            Some("wireless") => Some(LinkRole::Wireless),
            _ => None,
        }
    }
}

/// Names of units, and the count at zero.
#[derive(Clone)]
pub struct Units {
    names: Option<String>,
    zero_count: Option<f64>,
}

impl FromStr for Units {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((unit, rest)) = text.split_once('@') else {
            return Ok(Self { names: Some(text.to_owned()), zero_count: None });
        };
        let (zero, rates) = rest.split_once(',').unwrap_or((rest, ""));
        let zero = zero.parse().map_err(|_| "give the count at zero as LSB@32768")?;
        let names = [unit, rates].into_iter().filter(|name| !name.is_empty());
        let names = names.collect::<Vec<_>>().join(",");
        // The unit of the file is kept where none is named.
        Ok(Self { names: Some(names).filter(|names| !names.is_empty()), zero_count: Some(zero) })
    }
}
