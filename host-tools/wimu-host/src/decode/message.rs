//! Decoding of a frame's body.

use wimu_link::batch::MAX_SENSOR;
use wimu_link::message::Epoch;
use wimu_link::tag::Tag;
use wimu_link::{Frame, Hello, Kind, Reply, Telemetry};
use wimu_model::DeviceTimeUs;

use super::event::Event;
use crate::calibration::source::ActiveParameters;

/// Content of a frame, before the decoder converts it to an event.
#[allow(clippy::large_enum_variant, reason = "lives for one frame")]
pub enum Message {
    Hello(Hello),
    Epoch(Epoch),
    Tag(Tag),
    Event(Event),
}

/// Reads a frame that is not a batch.
pub fn read(&Frame { kind, body, .. }: &Frame<'_>) -> Result<Message, String> {
    let text = |error: &dyn std::error::Error| error.to_string();
    Ok(Message::Event(match kind {
        Kind::Hello => {
            return Hello::decode(body).map(Message::Hello).map_err(|e| text(&e));
        }
        Kind::Reply => {
            Event::Reply { reply: Reply::decode(body).map_err(|e| text(&e))?, body: body.to_vec() }
        }
        Kind::Telemetry => match Telemetry::decode(body).map_err(|e| text(&e))? {
            Telemetry::Epoch(epoch) if epoch.sensor > MAX_SENSOR => {
                return Err(format!("an epoch of sensor {}", epoch.sensor));
            }
            Telemetry::Epoch(epoch) => return Ok(Message::Epoch(epoch)),
            Telemetry::Tag(tag) => return Ok(Message::Tag(tag)),
            Telemetry::Environment(environment) => Event::Environment(environment),
            Telemetry::Navigation(navigation) => Event::Navigation(navigation),
            Telemetry::Attitude(attitude) => Event::Attitude(attitude),
            Telemetry::Parameters(bytes) => {
                Event::Parameters(ActiveParameters::new(bytes.set().map_err(|e| text(&e))?))
            }
            Telemetry::Settings(settings) => Event::Settings(settings),
            Telemetry::Status(status) => Event::Status(status),
            Telemetry::Event { time_us, event } => {
                Event::Device { time: DeviceTimeUs(time_us), event }
            }
        },
        // A host's own frame, looped back.
        Kind::WhoAreYou | Kind::Request => {
            return Err("a frame of the host was looped back".to_owned());
        }
        other => return Err(format!("unknown frame kind {other:?}")),
    }))
}
