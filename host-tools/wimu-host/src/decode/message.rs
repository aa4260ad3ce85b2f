//! Decoding of a frame's body.

use wimu_link::batch::MAX_SENSOR;
use wimu_link::message::{Epoch, ParametersPiece, Payload};
use wimu_link::tag::Tag;
use wimu_link::{Answer, Frame, Hello, Kind, Reply, Telemetry, WIRE_VERSION};
use wimu_model::DeviceTimeUs;

use super::event::Event;

/// Content of a frame, before the decoder converts it to an event.
#[allow(clippy::large_enum_variant, reason = "lives for one frame")]
pub enum Message {
    Hello(Hello),
    Epoch(Epoch),
    Piece(ParametersPiece),
    Tag(Tag),
    Event(Event),
}

/// Reads a frame that is not a batch; `None` for a reply of an earlier version that later ones do not have.
pub fn read(frame: &Frame<'_>) -> Result<Option<Message>, String> {
    let (kind, body) = (frame.kind, frame.body);
    if kind == Kind::Reply && frame.version < WIRE_VERSION {
        return Ok(earlier_reply(body));
    }
    message(kind, body).map(Some)
}

/// Parameters came in one piece in version 1; its telemetry repeats them.
fn earlier_reply(body: &[u8]) -> Option<Message> {
    match Reply::decode(body).ok()? {
        Reply { answer: Answer::Accepted(Payload::Parameters { .. }), .. } => None,
        reply => Some(Message::Event(Event::Reply { reply, body: body.to_vec() })),
    }
}

fn message(kind: Kind, body: &[u8]) -> Result<Message, String> {
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
            Telemetry::ParametersPiece(piece) => return Ok(Message::Piece(piece)),
            Telemetry::Tag(tag) => return Ok(Message::Tag(tag)),
            Telemetry::Environment(environment) => Event::Environment(environment),
            Telemetry::Navigation(navigation) => Event::Navigation(navigation),
            Telemetry::Attitude(attitude) => Event::Attitude(attitude),
            Telemetry::Parameters(parameters) => Event::Parameters(parameters),
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
