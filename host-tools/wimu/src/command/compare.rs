//! `wimu compare`.

use std::path::Path;

use wimu_host::compare::{align, compare};
use wimu_host::document::ToDocument;
use wimu_host::mcap_file::RecordingReader;
use wimu_host::{Code, Input, Problem, Result};

use crate::arguments::Compare;
use crate::output::{Output, usage};

pub fn run(arguments: &Compare, output: &Output) -> Result<()> {
    let kind = |input: &String| Input::parse(input);
    match (kind(&arguments.input)?, arguments.other.as_ref()) {
        (Input::Recording(path), None) => recording(&path, arguments, output),
        (Input::File(reference), Some(other)) => {
            let Input::File(other) = kind(other)? else {
                return Err(unsupported(other));
            };
            tables(&reference, &other, output)
        }
        _ => Err(unsupported(&arguments.input)),
    }
}

fn unsupported(input: &str) -> Problem {
    usage("this input cannot be compared", "give one recording of both links, or two CSV files")
        .at(input)
}

fn recording(path: &Path, arguments: &Compare, output: &Output) -> Result<()> {
    let name = wimu_host::untrusted::name(path);
    let found = compare(|| RecordingReader::open(path), &name)?;
    let document = found.document();
    output.print(document.to_string());
    output.findings(&found.findings);
    if let Some(file) = &arguments.output {
        let model = found.values.as_ref().map(|values| &values.model);
        let model = model.ok_or_else(|| {
            Code::DataRefused
                .error(found.values_reason.clone().unwrap_or_default(), "record a longer motion")
                .at(&name)
        })?;
        model.write(file)?;
        output.print(format!(
            "wrote {}: the wireless link's error model, for `wimu convert --topic wireless --with`",
            file.display()
        ));
    }
    if let Some(file) = &arguments.report {
        document.write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    output.object(&found);
    Ok(())
}

fn tables(reference: &Path, other: &Path, output: &Output) -> Result<()> {
    let found = align(reference, other)?;
    output.print(found.document().to_string());
    output.findings(&found.findings);
    output.object(&found);
    Ok(())
}
