//! `wimu export`.

use serde::Serialize;
use wimu_host::calibration::{KalibrNoise, read_parameters, to_c, to_kalibr, to_rust};
use wimu_host::compare::LinkModel;
use wimu_host::export::{self, ExportStream};
use wimu_host::mimu4444::Capture;
use wimu_host::ros::{self, Decoded};
use wimu_host::{ErrorCode, HostError, Result};

use crate::arguments::{Export, ExportFormat, Stream};
use crate::command::not_over_input;
use crate::output::Output;

#[derive(Serialize)]
struct Exported {
    schema: &'static str,
    status: &'static str,
    file: String,
    link: Option<String>,
    rows: usize,
}

#[derive(Serialize)]
struct ExportedTopics {
    schema: &'static str,
    status: &'static str,
    file: String,
    #[serde(flatten)]
    decoded: Decoded,
}

pub fn run(arguments: &Export, output: Output) -> Result<()> {
    not_over_input(&arguments.input, Some(&arguments.output))?;
    let file = arguments.output.display().to_string();
    let model = arguments
        .link_model
        .as_deref()
        .map(LinkModel::read)
        .transpose()?;
    if arguments.noise.is_some() && !matches!(arguments.format, ExportFormat::Kalibr) {
        return Err(HostError::new(
            ErrorCode::Usage,
            "--noise goes with --format kalibr only",
            "leave it out",
        ));
    }
    let (rows, link) = match arguments.format {
        ExportFormat::Rust | ExportFormat::C | ExportFormat::Kalibr => {
            let set = read_parameters(&arguments.input)?;
            let text = match arguments.format {
                ExportFormat::Rust => to_rust(&set),
                ExportFormat::C => to_c(&set),
                _ => {
                    let noise = arguments.noise.as_deref();
                    to_kalibr(&set, noise.map(KalibrNoise::read).transpose()?)
                }
            };
            std::fs::write(&arguments.output, &text)
                .map_err(|error| HostError::file(&file, "write", &error))?;
            (text.lines().count(), None)
        }
        ExportFormat::Mcap => {
            let decoded = ros::decode(&arguments.input, &arguments.output, model.as_ref())?;
            for (topic, count) in &decoded.messages {
                output.say(format!("{file}: {count} messages on {topic}"));
            }
            output.object(&ExportedTopics {
                schema: "wimu.export_topics/1",
                status: "ok",
                file,
                decoded,
            });
            return Ok(());
        }
        ExportFormat::Mimu4444 => {
            if model.is_some() {
                return Err(HostError::new(
                    ErrorCode::Usage,
                    "a link model is of a wimu board's link",
                    "leave --link-model out",
                ));
            }
            let capture = Capture::read(&arguments.input)?;
            (capture.write_csv(&arguments.output)?, None)
        }
        ExportFormat::Csv => {
            let stream = match arguments.stream {
                Stream::Raw => ExportStream::Raw,
                Stream::Corrected => ExportStream::Corrected,
                Stream::Navigation => ExportStream::Navigation,
            };
            let role = arguments.link.map(Into::into);
            let (rows, role) = export::to_csv(
                &arguments.input,
                role,
                model.as_ref(),
                stream,
                &arguments.output,
            )?;
            (rows, Some(role.to_string()))
        }
    };
    let of = link
        .as_ref()
        .map_or(String::new(), |link| format!(" of the {link} link"));
    output.say(format!("{file}: {rows} rows{of}"));
    output.object(&Exported {
        schema: "wimu.export/1",
        status: "ok",
        file,
        link,
        rows,
    });
    Ok(())
}
