//! `wimu export`.

use serde::Serialize;
use wimu_host::Result;
use wimu_host::export::{self, ExportStream};
use wimu_host::history::Recording;

use crate::arguments::{Export, ExportFormat, Stream};
use crate::command::not_over_input;
use crate::output::Output;

#[derive(Serialize)]
struct Exported {
    schema: &'static str,
    status: &'static str,
    file: String,
    link: String,
    rows: usize,
}

pub fn run(arguments: &Export, output: Output) -> Result<()> {
    let ExportFormat::Csv = arguments.format;
    not_over_input(&arguments.input, Some(&arguments.output))?;
    let recording = Recording::load(&arguments.input)?;
    let link = recording.link(arguments.link.map(Into::into))?;
    let stream = match arguments.stream {
        Stream::Raw => ExportStream::Raw,
        Stream::Corrected => ExportStream::Corrected,
        Stream::Navigation => ExportStream::Navigation,
    };
    let rows = export::to_csv(link, recording.anchor, stream, &arguments.output)?;
    let file = arguments.output.display().to_string();
    output.say(format!("{file}: {rows} rows of the {} link", link.role));
    output.object(&Exported {
        schema: "wimu.export/1",
        status: "ok",
        file,
        link: link.role.to_string(),
        rows,
    });
    Ok(())
}
