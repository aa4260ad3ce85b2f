//! Failures as Python exceptions.

use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use wimu_host::{Code, Problem};

pyo3::create_exception!(
    wimu,
    WimuError,
    PyException,
    "A failure: `code` for programs, `message` what is wrong, `where` the file and line or None, `remedy` what to do."
);

/// An exception, whatever its cause.
pub struct Failure(PyErr);

pub type Result<T> = std::result::Result<T, Failure>;

/// A wrong argument.
pub fn usage(message: impl Into<String>, remedy: impl Into<String>) -> Failure {
    Code::Usage.error(message, remedy).into()
}

/// Data that do not support an answer.
pub fn refused(source: &str, reason: Option<&str>, remedy: String) -> Failure {
    let reason = reason.unwrap_or("the data do not support an answer");
    let error = Code::DataRefused.error(reason, remedy);
    error.at(source).into()
}

impl From<Problem> for Failure {
    fn from(error: Problem) -> Self {
        Python::attach(|py| {
            let raised = WimuError::new_err(error.to_string());
            let value = raised.value(py);
            let set = [
                ("code", Some(error.code.as_str())),
                ("message", Some(&*error.text)),
                ("where", error.place.at.as_deref()),
                ("remedy", Some(&*error.remedy)),
            ]
            .into_iter()
            .try_for_each(|(name, text)| value.setattr(name, text));
            Self(set.err().unwrap_or(raised))
        })
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        failure.0
    }
}
