//! Live plays: the request that starts one, and the messages of its connection in both directions.
//!
//! [`LiveRequest::parse`] reads a body, [`LiveMessage::parse`] a WebSocket's text. The daemon answers each message with one
//! [`LiveAnswer`], not always in their order.

use crate::body::{bad, check_scale, check_trigger, null_as_default, problem, read, split};
use crate::end_cause::EndCause;
use crate::order::{LIVE_TERMS, Terms};
use crate::problem::Problem;
use crate::rendering::object_schema;
use crate::trigger::{self, TriggerRequest};
use meissner_input::document::{self, given, keys_of};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// How long a client of a live play may be silent, ms, without `timeout_ms`.
pub const LIVE_TIMEOUT_MS: f64 = 500.0;
/// The rate of updates that the line must carry, Hz, without `updates_hz`.
pub const LIVE_UPDATES_HZ: f64 = 50.0;
/// How long pins take to get to a level, without `glide_ms`, ms.
pub const LIVE_GLIDE_MS: f64 = 20.0;
/// Bytes of a message, at most.
pub const MAX_LIVE_MESSAGE: usize = 1 << 16;

/// A motor's drive in a live play.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LiveDrive {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Frequency, Hz. Another one begins where the motor's next period would have begun.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub frequency_hz: f64,
    /// Amplitude, µm, peak to peak; 0: the motor is silent.
    #[schema(minimum = 0.0, maximum = 5000.0)]
    pub amplitude_um: f64,
    /// Phase, cycles; without it 0. Another one shifts the motor's strokes forwards by the difference.
    #[serde(default)]
    #[schema(minimum = 0.0, exclusive_maximum = 1.0)]
    pub phase: f64,
}

/// Where a live object is: turned anticlockwise about the array's middle, then shifted. A shift reaches as far as
/// the pad is long, 24 mm; pins of an array that is larger than the pad may stand beyond it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LivePose {
    /// The shift across the finger, mm; without it 0.
    #[serde(default)]
    #[schema(minimum = -24.0, maximum = 24.0)]
    pub x_mm: f64,
    /// The shift along the finger, towards the fingertip, mm; without it 0.
    #[serde(default)]
    #[schema(minimum = -24.0, maximum = 24.0)]
    pub y_mm: f64,
    /// The turn, degrees; without it 0.
    #[serde(default)]
    #[schema(minimum = -1e6, maximum = 1e6)]
    pub angle_deg: f64,
    /// How far an object's highest point is below the surface of the skin at rest, µm; without it the depth of the object's press.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 2000.0)]
    pub depth_um: Option<f64>,
}

/// A live play: its drives at the onset, and what its client may change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"drives": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 80.0}], "updates_hz": 100.0})))]
pub struct LiveRequest {
    /// The drives at the onset, one for each motor at most; the other motors are silent.
    #[serde(default, deserialize_with = "null_as_default")]
    pub drives: Vec<LiveDrive>,
    /// An object that the client presses and moves, instead of `drives`: the keys of an object file without files, whose touch is a press,
    /// or the name of a shipped one. Pins go to the heights whose skin is nearest to the object's, and are at rest until the first pose.
    /// The line must carry `levels`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = object_schema)]
    pub object: Option<Value>,
    /// Multiplies the amplitude of every drive; without it 1. An update may change it.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: Option<f64>,
    /// The play ends when its client is silent for so long, ms; without it 500. Then the pins return.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 50.0, maximum = 60_000.0)]
    pub timeout_ms: Option<f64>,
    /// The highest frequency of any update, Hz; without it the highest of `drives`, at least 60. The line must carry it.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub max_frequency_hz: Option<f64>,
    /// The rate of updates that the line must carry, Hz; without it 50. More are taken as far as the line carries them.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1.0, maximum = 1000.0)]
    pub updates_hz: Option<f64>,
    /// Whether messages may have `um`: pins follow levels. The line must carry it.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub levels: bool,
    /// What the trigger output gives at the onset; without it one pulse of 10 ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = trigger::schema)]
    pub trigger: Option<TriggerRequest>,
    /// How it is played; it begins as soon as it can.
    #[serde(flatten, skip_deserializing)]
    #[schema(ignore)]
    pub terms: Terms,
}

/// A live play was accepted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"id": 17, "path": "/v1/live/4d0f21c6a8e3b75940d1e2f3a4b5c6d7"})))]
pub struct LiveAccepted {
    /// The play's id, as in events and receipts.
    #[schema(minimum = 1)]
    pub id: u64,
    /// Where its connection is opened, once: the address has a key that only this answer names.
    pub path: String,
}

/// A message from the client of a live play. Without `drives`, `um`, `scale` and `end` it only shows that the client is there.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"seq": 7, "drives": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0}]})))]
pub struct LiveMessage {
    /// The client's number of the message, above that of the one before.
    pub seq: u64,
    /// New drives, one for each motor at most; the other motors' stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drives: Option<Vec<LiveDrive>>,
    /// Where the object is now.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<LivePose>,
    /// Levels for pins by their motors' numbers, above rest, µm, if the play was started with `levels`. A pin goes to its level and stays
    /// there, for 60 s at most; a drive for its motor takes its place. The scale of the time counts; a scale of 0 brings all pins down.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub um: BTreeMap<u8, f64>,
    /// How long pins take to get to these levels, ms; without it 20. With 0 they go at full speed.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1000.0)]
    pub glide_ms: Option<f64>,
    /// A new scale of all amplitudes.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: Option<f64>,
    /// Whether to end the play. The pins return.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub end: bool,
}

/// When an update is on the pins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiveApplied {
    /// The device's clock when the message had come, ticks.
    pub received_tick: u64,
    /// From when strokes were replaced, each motor's from its next period on, ticks.
    pub from_tick: u64,
    /// Per motor: from when it has its new drive, ticks; null: it had it before, or gets it with a later update.
    pub ticks: Vec<Option<u64>>,
    /// How often the device got it too late for some motor, so that it was sent again.
    pub repeats: u32,
    /// Moves of the play that the device has refused since the answer before: they are not on the pins. The events `refused` say which, and
    /// why.
    pub refused: u64,
}

/// The daemon's answer to a message: exactly one of the keys besides `seq`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"seq": 5, "merged_into": 7})))]
pub struct LiveAnswer {
    /// The message's number; null: the answer is about the play, or the number cannot be read.
    #[schema(required)]
    pub seq: Option<u64>,
    /// It is on the device.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub applied: Option<LiveApplied>,
    /// A later message took its place before it was sent: what both change, the later one decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub merged_into: Option<u64>,
    /// It was refused, and changed nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<Problem>,
    /// The play is over. The daemon closes the connection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub ended: Option<EndCause>,
}

fn check_drives(drives: &[LiveDrive]) -> Result<(), Problem> {
    let mut seen = BTreeSet::new();
    for (at, LiveDrive { motor, frequency_hz, amplitude_um, phase }) in drives.iter().enumerate() {
        let key = |key: &str| format!("drives[{at}].{key}");
        let range = |name: &str, value: f64, good: bool, wanted: &'static str| {
            document::in_range(&key(name), value, good, wanted).map_err(problem)
        };
        range("frequency_hz", *frequency_hz, (0.1..=300.0).contains(frequency_hz), "0.1 to 300 Hz")?;
        // The daemon knows the array's motors, and how far they go.
        range("amplitude_um", *amplitude_um, *amplitude_um >= 0.0, "0 um or more")?;
        range("phase", *phase, (0.0..1.0).contains(phase), "at least 0 and below 1")?;
        if !seen.insert(*motor) {
            return Err(bad(format!("`drives` has motor {motor} twice: leave one out")));
        }
    }
    Ok(())
}

fn check_pose(pose: Option<LivePose>) -> Result<(), Problem> {
    let Some(LivePose { x_mm, y_mm, angle_deg, depth_um }) = pose else { return Ok(()) };
    for (key, value, most, wanted) in [
        ("pose.x_mm", x_mm, 24.0, "-24 to 24 mm"),
        ("pose.y_mm", y_mm, 24.0, "-24 to 24 mm"),
        ("pose.angle_deg", angle_deg, 1e6, "-1000000 to 1000000 degrees"),
    ] {
        document::in_range(key, value, (-most..=most).contains(&value), wanted).map_err(problem)?;
    }
    let depth_um = depth_um.unwrap_or(0.0);
    document::in_range("pose.depth_um", depth_um, (0.0..=2000.0).contains(&depth_um), "0 to 2000 um")
        .map_err(problem)
}

impl LiveRequest {
    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let (request, terms): (Self, Terms) = split(read(body)?, [keys_of::<Self>(), &LIVE_TERMS])?;
        let request = Self { terms, ..request };
        check_drives(&request.drives)?;
        request.check_object()?;
        request.terms.check()?;
        check_scale(request.scale).and_then(|()| check_trigger(request.trigger)).map_err(bad)?;
        let ranges = [
            ("timeout_ms", request.timeout_ms, 50.0, 60_000.0, "50 to 60000 ms"),
            ("max_frequency_hz", request.max_frequency_hz, 0.1, 300.0, "0.1 to 300 Hz"),
            ("updates_hz", request.updates_hz, 1.0, 1000.0, "1 to 1000 Hz"),
        ];
        for (key, value, least, most, wanted) in ranges {
            let Some(value) = value else { continue };
            document::in_range(key, value, (least..=most).contains(&value), wanted).map_err(problem)?;
        }
        Ok(request)
    }

    fn check_object(&self) -> Result<(), Problem> {
        let Some(object) = &self.object else { return Ok(()) };
        if !self.drives.is_empty() {
            return Err(bad("`object` and `drives` exclude each other: leave one out"));
        }
        if !object.is_string() && !object.is_object() {
            return Err(bad(
                "`object` must be the name of an object, or an object with the keys of an object file",
            ));
        }
        Ok(())
    }

    /// The highest frequency of any update, Hz.
    pub fn most_hz(&self) -> f64 {
        let initial = self.drives.iter().map(|drive| drive.frequency_hz).fold(60.0, f64::max);
        self.max_frequency_hz.unwrap_or(initial)
    }
}

impl LiveMessage {
    /// Reads a message.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(text: &[u8]) -> Result<Self, Problem> {
        let message: Self = read(text)?;
        check_drives(message.drives.as_deref().unwrap_or_default())?;
        check_pose(message.pose)?;
        check_scale(message.scale).map_err(bad)?;
        for (motor, um) in &message.um {
            // The daemon knows the array's motors, and how far they go.
            document::in_range(&format!("um.{motor}"), *um, *um >= 0.0, "0 um or more").map_err(problem)?;
            if message.drives.iter().flatten().any(|drive| drive.motor == *motor) {
                return Err(bad(format!("`drives` and `um` both have motor {motor}: leave one out")));
            }
        }
        if let Some(ms) = message.glide_ms {
            document::in_range("glide_ms", ms, (0.0..=1000.0).contains(&ms), "0 to 1000 ms")
                .map_err(problem)?;
        }
        Ok(message)
    }

    /// The number of a message, also of a bad one if its number is good: the answer names it.
    pub fn seq(text: &[u8]) -> Option<u64> {
        serde_json::from_slice::<BTreeMap<String, Value>>(text).ok()?.get("seq")?.as_u64()
    }
}

impl LiveAnswer {
    /// A message was refused.
    pub fn refused(seq: Option<u64>, problem: Problem) -> Self {
        Self { seq, problem: Some(problem), ..Self::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_key() {
        let message = LiveMessage::parse(
            br#"{"seq":1,"drives":[{"motor":2,"frequency_hz":60,"amplitude_um":80}],"scale":0.5}"#,
        )
        .unwrap();
        assert_eq!(message.drives.as_ref().unwrap()[0].phase, 0.0);
        assert_eq!(LiveMessage::parse(&serde_json::to_vec(&message).unwrap()).unwrap(), message);
        let drive = |keys: &str| {
            format!(r#"{{"seq":1,"drives":[{{"motor":1,"frequency_hz":60,"amplitude_um":80{keys}}}]}}"#)
        };
        for (text, says) in [
            (r#"{"drives":[]}"#.to_owned(), "`seq` is missing"),
            (r#"{"seq":-1}"#.to_owned(), "`seq` is integer `-1`"),
            (r#"{"seq":1,"scale":1.5}"#.to_owned(), "`scale`"),
            (
                r#"{"seq":1,"pose":{"depth_um":2001}}"#.to_owned(),
                "`pose.depth_um` is 2001: must be 0 to 2000 um",
            ),
            (r#"{"seq":1,"pose":{"depth_um":NaN}}"#.to_owned(), "JSON"),
            (r#"{"seq":1,"drvies":[]}"#.to_owned(), "did you mean `drives`?"),
            (drive(r#","phase":1.0"#), "`drives[0].phase` is 1: must be at least 0 and below 1"),
            (drive(r#","start_s":1.0"#), "unknown key `start_s`"),
            (drive("").replace(":80", ":-1"), "`drives[0].amplitude_um` is -1: must be 0 um or more"),
            (
                drive("").replace("[{", "[{\"motor\":1,\"frequency_hz\":1,\"amplitude_um\":1},{"),
                "motor 1 twice",
            ),
        ] {
            let refused = LiveMessage::parse(text.as_bytes()).unwrap_err();
            assert!(refused.detail.contains(says), "{text}: {}", refused.detail);
        }
        for (text, says) in [
            (r#"{"timeout_ms":10}"#, "`timeout_ms` is 10: must be 50 to 60000 ms"),
            (
                r#"{"object":"dot","drives":[{"motor":1,"frequency_hz":60,"amplitude_um":80}]}"#,
                "`object` and `drives` exclude each other",
            ),
            (r#"{"object":3}"#, "`object` must be the name of an object"),
            (r#"{"updates_hz":0}"#, "`updates_hz` is 0: must be 1 to 1000 Hz"),
            (r#"{"max_frequency_hz":301}"#, "`max_frequency_hz` is 301"),
        ] {
            let refused = LiveRequest::parse(text.as_bytes()).unwrap_err();
            assert!(refused.detail.contains(says), "{text}: {}", refused.detail);
        }
        assert_eq!(LiveRequest::parse(b"{}").unwrap().most_hz(), 60.0);
    }
}
