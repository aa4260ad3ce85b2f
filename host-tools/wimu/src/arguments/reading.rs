//! How recordings are read: options that several commands share.

use clap::Args;
use wimu_host::csv::Filter;
use wimu_host::formats::ReadOptions;
use wimu_link::LinkRole;

#[derive(Args)]
#[command(next_help_heading = "Reading FILE")]
pub struct Reading {
    /// Rows of a table to use: those whose columns have these values, such as "Run=2,IMU=0"
    #[arg(long = "where", value_name = "COLUMN=VALUE,…")]
    pub filter: Option<Filter>,
    /// Format of the file, by its name in docs/FORMATS.md [default: detected by its content]
    #[arg(long, value_name = "NAME")]
    pub format: Option<String>,
    /// Topic, message or log to read, where the file has several; of a recording of wimu the link: cable or wireless
    /// [default: the cable if it was recorded]
    #[arg(long, value_name = "NAME")]
    pub topic: Option<String>,
    /// Columns of a table, by header or by number from 1, with units: "t=timestamp:ns,x=ax:g,y=ay:g,z=az:g"
    #[arg(long, value_name = "LIST")]
    pub columns: Option<String>,
    /// Units instead of those of the file: of accelerations m/s2, g, mg, mm/s2 or LSB, of rates rad/s or deg/s: g,deg/s
    #[arg(long, value_name = "UNIT")]
    pub units: Option<String>,
    /// Sample rate of a table, Hz, instead of its times
    #[arg(long, value_name = "HZ", value_parser = super::from_to(1e-3, 1e6))]
    pub rate: Option<f64>,
    /// Count at zero acceleration, such as 32768 [default: detected]
    #[arg(long, value_name = "LSB")]
    pub zero_count: Option<f64>,
}

impl Reading {
    /// The same for the library; `poses` if the rows of a table are means over static poses.
    pub fn options(&self, poses: bool) -> ReadOptions {
        let mut options = ReadOptions::default();
        options.format = self.format.clone();
        options.topic = self.topic.clone();
        options.columns = self.columns.clone();
        options.units = self.units.clone();
        options.rate_hz = self.rate;
        options.zero_count = self.zero_count;
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
