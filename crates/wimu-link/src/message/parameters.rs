//! Parameter sets on the wire.

use core::fmt;

use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::ser::{SerializeTuple, Serializer};
use serde::{Deserialize, Serialize};
use wimu_model::{
    Alignment, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters,
    GyroscopeTemperatureTerms, GyroscopeTerms, ParameterId, ParameterSet, Sensitivity, SensorId,
    TemperatureTerms,
};

use super::MessageError;
use super::bytes::Piece;
use super::exchange::{Reader, Wire, Writer, begins, byte, doubles, floats, option};
use super::fault::ParameterFault;
use super::quality::{WireMagnetometer, WireQuality, rotation_covariance, rotation_factor};
use super::request::Command;
use crate::checksum::{Digest, crc_32c};
use crate::frame::EncodeError;

/// Wire form of a [`ParameterSet`]: numbers in this order, not validated.
///
/// ```
/// use wimu_link::message::{ParameterFault, WireParameters};
/// use wimu_model::{ParameterSet, Sensitivity};
///
/// let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0)?);
/// let mut wire = WireParameters::from(&set);
/// assert_eq!(ParameterSet::try_from(&wire), Ok(set));
///
/// wire.bias_mps2[1] = f64::NAN;
/// let fault = ParameterSet::try_from(&wire).unwrap_err();
/// assert_eq!(fault.to_string(), "bias Y is not a finite number");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireParameters {
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity, LSB/*g*.
    pub sensitivity_lsb_per_g: f64,
    /// b₀, m/s².
    pub bias_mps2: [f64; 3],
    /// A, row by row.
    pub matrix: [[f64; 3]; 3],
    /// T₀, °C.
    pub reference_c: f64,
    /// b₁, m/s² per K.
    pub bias_mps2_per_k: [f64; 3],
    /// b₂, m/s² per K².
    pub bias_mps2_per_k2: [f64; 3],
    /// s₁, 1/K.
    pub scale_per_k: [f64; 3],
    /// q, s²/m.
    pub nonlinearity: [f64; 3],
    /// Sensor axes to body axes, quaternion W, X, Y, Z.
    pub alignment_wxyz: [f64; 4],
    /// Cholesky factor (lower triangular) of the covariance of the alignment error, rad, row by row.
    pub alignment_factor: Option<[f32; 6]>,
    /// Method and quality of the calibration.
    pub quality: Option<WireQuality>,
    /// The magnetometer's model.
    pub magnetometer: Option<WireMagnetometer>,
    /// The accelerometer that was calibrated, a number of [`sensor`](crate::hello::sensor). `None` if the
    /// set ends before it, or where later fields follow and it is 0.
    pub sensor: Option<u16>,
    /// Index of the sensor on its board; 0 if the set ends before it.
    pub sensor_index: u8,
    /// The gyroscope's model; `None` if the set ends before it. A set may gain fields at its end only.
    pub gyroscope: Option<WireGyroscope>,
}

/// Wire form of [`GyroscopeParameters`], not validated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireGyroscope {
    /// Full-scale range, ± °/s.
    pub range_dps: u16,
    /// Nominal sensitivity, rad/s per LSB.
    pub rad_s_per_lsb: f64,
    /// b₀, rad/s.
    pub bias_rad_s: [f64; 3],
    /// A, row by row.
    pub matrix: [[f64; 3]; 3],
    /// G, rad/s per m/s², row by row.
    pub g_sensitivity: [[f64; 3]; 3],
    /// T₀, °C.
    pub reference_c: f64,
    /// b₁, rad/s per K.
    pub bias_rad_s_per_k: [f64; 3],
    /// s₁, 1/K.
    pub scale_per_k: [f64; 3],
    /// Standard deviations: b₀, rad/s; A row by row.
    pub sd: Option<[f32; 12]>,
}

impl WireGyroscope {
    const BLANK: Self = Self {
        range_dps: 0,
        rad_s_per_lsb: 0.0,
        bias_rad_s: [0.0; 3],
        matrix: [[0.0; 3]; 3],
        g_sensitivity: [[0.0; 3]; 3],
        reference_c: 0.0,
        bias_rad_s_per_k: [0.0; 3],
        scale_per_k: [0.0; 3],
        sd: None,
    };

    fn exchange(wire: &mut dyn Wire, gyroscope: &mut Self) -> Result<(), MessageError> {
        let mut range_dps = gyroscope.range_dps.to_le_bytes();
        wire.exchange(&mut range_dps)?;
        gyroscope.range_dps = u16::from_le_bytes(range_dps);
        for values in [
            core::slice::from_mut(&mut gyroscope.rad_s_per_lsb),
            &mut gyroscope.bias_rad_s,
            gyroscope.matrix.as_flattened_mut(),
            gyroscope.g_sensitivity.as_flattened_mut(),
            core::slice::from_mut(&mut gyroscope.reference_c),
            &mut gyroscope.bias_rad_s_per_k,
            &mut gyroscope.scale_per_k,
        ] {
            doubles(wire, values)?;
        }
        option(wire, &mut gyroscope.sd, [0.0; 12], |wire, sd| floats(wire, sd))
    }
}

/// An optional part of a set, if it is used.
fn part<'a, W, T: TryFrom<&'a W>>(wire: Option<&'a W>, used: bool) -> Result<Option<T>, T::Error> {
    wire.filter(|_| used).map(TryInto::try_into).transpose()
}

impl WireParameters {
    /// Longest wire form, bytes.
    pub const MAX: usize = 1122;

    /// All zeros, for [`read`](Self::read).
    pub const BLANK: Self = Self {
        range_g: 0,
        sensitivity_lsb_per_g: 0.0,
        bias_mps2: [0.0; 3],
        matrix: [[0.0; 3]; 3],
        reference_c: 0.0,
        bias_mps2_per_k: [0.0; 3],
        bias_mps2_per_k2: [0.0; 3],
        scale_per_k: [0.0; 3],
        nonlinearity: [0.0; 3],
        alignment_wxyz: [0.0; 4],
        alignment_factor: None,
        quality: None,
        magnetometer: None,
        sensor: None,
        sensor_index: 0,
        gyroscope: None,
    };

    fn exchange(&mut self, wire: &mut dyn Wire) -> Result<(), MessageError> {
        self.exchange_terms(wire)?;
        let more = self.sensor_index != 0 || self.gyroscope.is_some();
        let [mut low, mut high] = self.sensor.unwrap_or(0).to_le_bytes();
        if !begins(wire, more || self.sensor.is_some(), &mut low)? {
            return Ok(());
        }
        byte(wire, &mut high)?;
        self.sensor = Some(u16::from_le_bytes([low, high]));
        if !begins(wire, more, &mut self.sensor_index)? {
            return Ok(());
        }
        self.sensor = self.sensor.filter(|number| *number != 0);
        option(wire, &mut self.gyroscope, WireGyroscope::BLANK, WireGyroscope::exchange)
    }

    /// The fields that every set has.
    fn exchange_terms(&mut self, wire: &mut dyn Wire) -> Result<(), MessageError> {
        byte(wire, &mut self.range_g)?;
        for values in [
            core::slice::from_mut(&mut self.sensitivity_lsb_per_g),
            &mut self.bias_mps2,
            self.matrix.as_flattened_mut(),
            core::slice::from_mut(&mut self.reference_c),
            &mut self.bias_mps2_per_k,
            &mut self.bias_mps2_per_k2,
            &mut self.scale_per_k,
            &mut self.nonlinearity,
            &mut self.alignment_wxyz,
        ] {
            doubles(wire, values)?;
        }
        option(wire, &mut self.alignment_factor, [0.0; 6], |wire, factor| floats(wire, factor))?;
        option(wire, &mut self.quality, WireQuality::BLANK, WireQuality::exchange)?;
        option(wire, &mut self.magnetometer, WireMagnetometer::BLANK, WireMagnetometer::exchange)
    }

    /// The set with those of its optional parts that a device uses, validated; the others are `None`. The alignment's
    /// covariance comes with quality or magnetometer.
    ///
    /// # Errors
    /// [`ParameterFault`]: what is invalid in the decoded parts.
    pub fn to_set<const QUALITY: bool, const MAGNETOMETER: bool, const GYROSCOPE: bool>(
        &self,
    ) -> Result<ParameterSet, ParameterFault> {
        Ok(ParameterSet {
            range_g: self.range_g,
            sensitivity: Sensitivity::from_lsb_per_g(self.sensitivity_lsb_per_g)?,
            model: ErrorModel::new(ErrorTerms {
                bias_mps2: self.bias_mps2,
                matrix: self.matrix,
                temperature: TemperatureTerms {
                    reference_c: self.reference_c,
                    bias_mps2_per_k: self.bias_mps2_per_k,
                    bias_mps2_per_k2: self.bias_mps2_per_k2,
                    scale_per_k: self.scale_per_k,
                },
                nonlinearity: self.nonlinearity,
            })?,
            quality: part(self.quality.as_ref(), QUALITY)?,
            alignment: Alignment::try_from(self.alignment_wxyz)?,
            alignment_covariance: (self.alignment_factor)
                .filter(|_| QUALITY || MAGNETOMETER)
                .map(rotation_covariance)
                .transpose()?,
            magnetometer: part(self.magnetometer.as_ref(), MAGNETOMETER)?,
            sensor: self.sensor.map(SensorId),
            sensor_index: self.sensor_index,
            gyroscope: part(self.gyroscope.as_ref(), GYROSCOPE)?,
        })
    }

    /// Replaces the quaternions by the normalised ones of `set`, which was decoded from `self`.
    pub fn take_rotations(&mut self, set: &ParameterSet) {
        self.alignment_wxyz = set.alignment.quaternion();
        let theirs = set.magnetometer.as_ref();
        let theirs = theirs.and_then(|model| model.terms().to_accelerometer.as_ref());
        let ours = self.magnetometer.as_mut();
        let ours = ours.and_then(|model| model.to_accelerometer.as_mut());
        if let (Some(ours), Some(theirs)) = (ours, theirs) {
            ours.rotation_wxyz = theirs.rotation.quaternion();
        }
    }

    /// Writes its wire form to `bytes`, of which [`MAX`](Self::MAX) are enough; returns its length.
    ///
    /// # Errors
    /// [`EncodeError::NoRoom`] when it does not fit.
    pub fn encode(&self, bytes: &mut [u8]) -> Result<usize, EncodeError> {
        let mut writer = Writer(bytes, 0);
        let mut copy = *self;
        let written = copy.exchange(&mut writer);
        written.map_err(|_| EncodeError::NoRoom)?;
        Ok(writer.1)
    }

    /// The commands that stage it, in order.
    pub fn stage(&self) -> impl Iterator<Item = Command> {
        let mut bytes = [0; Self::MAX];
        let total = self.encode(&mut bytes).unwrap_or(0);
        (0..total).step_by(Piece::MAX).map(move |offset| {
            let piece = bytes.get(offset..total.min(offset + Piece::MAX));
            Command::StageParameters {
                offset: offset as u16,
                total: total as u16,
                piece: Piece::new(piece.unwrap_or_default()).unwrap_or_default(),
            }
        })
    }

    /// Reads a wire form.
    ///
    /// # Errors
    /// [`MessageError`] when `bytes` are not exactly one set.
    pub fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
        let mut parameters = Self::BLANK;
        parameters.read(bytes)?;
        Ok(parameters)
    }

    /// Reads a wire form into [`BLANK`](Self::BLANK), which saves the stack of a copy.
    ///
    /// # Errors
    /// [`MessageError`] when `bytes` are not exactly one set.
    pub fn read(&mut self, bytes: &[u8]) -> Result<(), MessageError> {
        let mut reader = Reader(bytes);
        self.exchange(&mut reader)?;
        match reader.0 {
            [] => Ok(()),
            rest => Err(MessageError::TooLong { extra: rest.len() }),
        }
    }
}

// Within messages that serde encodes, a set is the sequence of its bytes.

impl Serialize for WireParameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = [0; Self::MAX];
        let length = self.encode(&mut bytes).unwrap_or(0);
        EncodedParameters(bytes.get(..length).unwrap_or_default()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for WireParameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bytes;

        struct Elements<A, E> {
            elements: A,
            failure: Option<E>,
        }

        impl<'de, A: SeqAccess<'de>> Wire for Elements<A, A::Error> {
            fn reads(&self) -> bool {
                true
            }

            fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), MessageError> {
                for byte in bytes {
                    match self.elements.next_element() {
                        Ok(Some(next)) => *byte = next,
                        Ok(None) => return Err(MessageError::TooShort),
                        Err(failure) => {
                            self.failure = Some(failure);
                            return Err(MessageError::TooShort);
                        }
                    }
                }
                Ok(())
            }
        }

        impl<'de> Visitor<'de> for Bytes {
            type Value = WireParameters;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("a parameter set")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, elements: A) -> Result<WireParameters, A::Error> {
                let mut parameters = WireParameters::BLANK;
                let mut wire = Elements { elements, failure: None };
                match (parameters.exchange(&mut wire), wire.failure) {
                    (Ok(()), _) => Ok(parameters),
                    (Err(_), Some(failure)) => Err(failure),
                    (Err(fault), None) => Err(de::Error::custom(fault)),
                }
            }
        }

        deserializer.deserialize_tuple(Self::MAX, Bytes)
    }
}

/// A piece of the parameters in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParametersPiece<P = Piece> {
    /// The id of the committed set, 0 without one.
    pub id: u32,
    /// The piece's first byte.
    pub offset: u16,
    /// Length of the set's wire form, bytes; 0 if the device is uncalibrated.
    pub total: u16,
    /// At most 256 bytes; none from the set's end on.
    pub piece: P,
}

impl ParametersPiece {
    /// The same with borrowed bytes.
    pub fn borrowed(&self) -> ParametersPiece<&[u8]> {
        ParametersPiece {
            id: self.id,
            offset: self.offset,
            total: self.total,
            piece: self.piece.as_bytes(),
        }
    }
}

/// A parameter set as the bytes of its wire form. A device keeps this form because it does not use most of
/// the content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EncodedParameters<'a>(pub &'a [u8]);

impl<'a> EncodedParameters<'a> {
    /// The set.
    ///
    /// # Errors
    /// [`MessageError`] when the bytes are not exactly one.
    pub fn decode(self) -> Result<WireParameters, MessageError> {
        WireParameters::decode(self.0)
    }

    /// The piece from `offset` on, of a set with this `id`.
    pub fn piece(self, id: ParameterId, offset: u16) -> ParametersPiece {
        let rest = self.0.get(offset.into()..).unwrap_or_default();
        let piece = rest.get(..Piece::MAX).unwrap_or(rest);
        ParametersPiece {
            id: id.0,
            offset,
            total: self.0.len() as u16,
            piece: Piece::new(piece).unwrap_or_default(),
        }
    }

    /// The set's id, equal to [`parameter_id`].
    pub fn id(self) -> ParameterId {
        ParameterId(crc_32c(self.0).max(1))
    }
}

impl Serialize for EncodedParameters<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        for byte in self.0 {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for EncodedParameters<'de> {
    /// Fails: the bytes do not contain their length. The enclosing message decodes them.
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        Err(de::Error::custom("parameters of unknown length"))
    }
}

impl From<&ParameterSet> for WireParameters {
    fn from(set: &ParameterSet) -> Self {
        let terms = set.model.terms();
        Self {
            range_g: set.range_g,
            sensitivity_lsb_per_g: set.sensitivity.lsb_per_g(),
            bias_mps2: terms.bias_mps2,
            matrix: terms.matrix,
            reference_c: terms.temperature.reference_c,
            bias_mps2_per_k: terms.temperature.bias_mps2_per_k,
            bias_mps2_per_k2: terms.temperature.bias_mps2_per_k2,
            scale_per_k: terms.temperature.scale_per_k,
            nonlinearity: terms.nonlinearity,
            alignment_wxyz: set.alignment.quaternion(),
            alignment_factor: set.alignment_covariance.map(rotation_factor),
            quality: set.quality.as_ref().map(WireQuality::from),
            magnetometer: set.magnetometer.as_ref().map(WireMagnetometer::from),
            sensor: set.sensor.map(|SensorId(number)| number),
            sensor_index: set.sensor_index,
            gyroscope: set.gyroscope.as_ref().map(WireGyroscope::from),
        }
    }
}

impl TryFrom<&WireParameters> for ParameterSet {
    type Error = ParameterFault;

    /// Validates every number. [`Corrector::compile`](wimu_model::Corrector::compile) checks whether the set
    /// can be compiled to integers.
    fn try_from(wire: &WireParameters) -> Result<Self, ParameterFault> {
        wire.to_set::<true, true, true>()
    }
}

impl From<&GyroscopeParameters> for WireGyroscope {
    fn from(gyroscope: &GyroscopeParameters) -> Self {
        let terms = gyroscope.model.terms();
        Self {
            range_dps: gyroscope.range_dps,
            rad_s_per_lsb: gyroscope.rad_s_per_lsb,
            bias_rad_s: terms.bias_rad_s,
            matrix: terms.matrix,
            g_sensitivity: terms.g_sensitivity,
            reference_c: terms.temperature.reference_c,
            bias_rad_s_per_k: terms.temperature.bias_rad_s_per_k,
            scale_per_k: terms.temperature.scale_per_k,
            sd: gyroscope.sd,
        }
    }
}

impl TryFrom<&WireGyroscope> for GyroscopeParameters {
    type Error = ParameterFault;

    fn try_from(wire: &WireGyroscope) -> Result<Self, ParameterFault> {
        let model = GyroscopeModel::new(GyroscopeTerms {
            bias_rad_s: wire.bias_rad_s,
            matrix: wire.matrix,
            g_sensitivity: wire.g_sensitivity,
            temperature: GyroscopeTemperatureTerms {
                reference_c: wire.reference_c,
                bias_rad_s_per_k: wire.bias_rad_s_per_k,
                scale_per_k: wire.scale_per_k,
            },
        })?;
        Ok(Self::new(wire.range_dps, wire.rad_s_per_lsb, model, wire.sd)?)
    }
}

/// The id of `set`: CRC-32C of its wire form, 1 in place of 0, which is the uncalibrated set's.
pub fn parameter_id(set: &ParameterSet) -> ParameterId {
    let mut digest = Digest::new();
    // A digest cannot fail.
    let _ = WireParameters::from(set).exchange(&mut digest);
    ParameterId(digest.finalize().max(1))
}
