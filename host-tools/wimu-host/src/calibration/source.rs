//! Sources of the compiled sets that devices hold: the calibrations in f64, by id.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Mutex;

use wimu_model::{
    CompileError, CompiledSet, GyroscopeModel, GyroscopeParameters, ModelError, ParameterId,
    ParameterSet, Sensitivity,
};

use super::{Calibration, parameter_id, read_parameters};
use crate::keys;
use crate::{Code, Problem, Result};

/// What has been pushed or read in this process. An id is that of the content, so that none is ever replaced.
static KNOWN: Mutex<BTreeMap<u32, ParameterSet>> = Mutex::new(BTreeMap::new());

/// Parameters as a device reports them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActiveParameters {
    /// Id of the source; 0 without parameters.
    pub id: u32,
    /// The set; `None` if the device is uncalibrated.
    pub active: Option<CompiledSet>,
}

impl ActiveParameters {
    /// Those of a set, or none.
    pub fn new(active: Option<CompiledSet>) -> Self {
        Self { id: active.map_or(0, |set| set.source().0), active }
    }

    /// The calibration: the source, if it is known here, else what its integers are, without uncertainty. `None` of an
    /// uncalibrated device. `sensitivity` is the nominal one of the sensor, if it is known.
    ///
    /// # Errors
    /// [`ModelError`] where the integers are no error model.
    pub fn calibration(
        &self,
        sensitivity: Option<Sensitivity>,
    ) -> std::result::Result<Option<ParameterSet>, ModelError> {
        let Some(set) = &self.active else { return Ok(None) };
        if let Some(source) = find(set.source()) {
            return Ok(Some(source));
        }
        set.to_model(sensitivity).map(Some)
    }

    /// A note where the source is not known here: what [`calibration`](Self::calibration) lacks then.
    pub fn unknown_source(&self) -> Option<Problem> {
        let set = self.without_source()?;
        let mut text = format!(
            "the source of the calibration {} is not known here; its uncertainty is unknown",
            set.source()
        );
        for (sensor, has_part) in [
            ("gyroscope", set.gyroscope(None).is_some()),
            ("magnetometer", set.compass().is_some()),
        ] {
            if has_part {
                text += &format!(", and its part for the {sensor} is left out");
            }
        }
        let note = Code::SourceUnknown.note(text);
        Some(note.remedy("name its CAL.json, or use the computer that pushed it"))
    }

    /// Whether [`calibration`](Self::calibration) lacks the gyroscope's part, because the source is not known here.
    pub fn lacks_gyroscope(&self) -> bool {
        self.without_source().is_some_and(|set| set.gyroscope(None).is_some())
    }

    fn without_source(&self) -> Option<&CompiledSet> {
        self.active.as_ref().filter(|set| find(set.source()).is_none())
    }
}

/// The user's folder of calibrations that were pushed, beside that of the keys.
fn folder() -> Option<PathBuf> {
    Some(keys::configuration().ok()?.join("calibrations"))
}

/// Remembers a calibration in this process.
pub fn learn(set: &ParameterSet) {
    if let Ok(mut known) = KNOWN.lock() {
        known.entry(parameter_id(set).0).or_insert(*set);
    }
}

/// Remembers a calibration on this computer, as a file named by its id.
///
/// # Errors
/// `file_failed`.
pub fn keep(set: &ParameterSet) -> Result<()> {
    learn(set);
    let Some(folder) = folder() else { return Ok(()) };
    let path = folder.join(format!("{}.json", parameter_id(set)));
    if path.exists() {
        return Ok(());
    }
    let failed = |error| Problem::file(&folder.display().to_string(), "create", &error);
    std::fs::create_dir_all(&folder).map_err(failed)?;
    Calibration::held(set).write(&path)
}

/// A calibration as a recording keeps it.
pub fn to_text(set: &ParameterSet) -> String {
    Calibration::held(set).text()
}

/// Remembers a calibration that a recording has kept in this process; a damaged one is left out.
pub fn learn_text(text: &str) {
    if let Ok(set) = Calibration::parse(text).and_then(|calibration| calibration.parameters()) {
        learn(&set);
    }
}

/// The calibration with an id, if it is known in this process or on this computer.
pub fn find(id: ParameterId) -> Option<ParameterSet> {
    if let Some(set) = KNOWN.lock().ok()?.get(&id.0) {
        return Some(*set);
    }
    let set = read_parameters(&folder()?.join(format!("{id}.json"))).ok()?;
    (parameter_id(&set) == id).then(|| {
        learn(&set);
        set
    })
}

/// `set` compiled for the device with the id `device` (0: any): with a gyroscope of the nominal scale `rad_s_per_lsb`, an
/// ideal one if `set` has none, and with the magnetometer's part if `magnetometer`.
///
/// # Errors
/// [`CompileError`].
pub fn compiled_for(
    set: &ParameterSet,
    device: u64,
    rad_s_per_lsb: Option<f64>,
    magnetometer: bool,
) -> std::result::Result<CompiledSet, CompileError> {
    let ideal = rad_s_per_lsb.and_then(|nominal| {
        GyroscopeParameters::new(1, nominal, GyroscopeModel::default(), None).ok()
    });
    let gyroscope = set.gyroscope.or(ideal).filter(|_| rad_s_per_lsb.is_some());
    let magnetometer = set.magnetometer.filter(|_| magnetometer && gyroscope.is_none());
    let parts = ParameterSet { gyroscope, magnetometer, ..*set };
    CompiledSet::compile(&parts, parameter_id(set), device)
}
