//! Lines of stdin, each a message: `X_MM Y_MM [DEGREES [DEPTH_UM]]`, a level for each of some motors, or a JSON object with the keys of a live
//! play's message.
//!
//! Lines of a regular file are taken one by one, when they are due. Lines of any other input are taken as they come.
//!
//! Bounds: a line has 64 KiB at most. Invariant: no line is skipped: a line that cannot be read is an error with its number.

use anyhow::{Context, Result, anyhow, bail};
use meissner_api::{LiveMessage, MAX_LIVE_MESSAGE};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};

/// Bytes that are read at a time; in between the loop handles answers and signals.
const PIECE: usize = 1 << 14;
/// Characters of a bad line that its message quotes.
const QUOTED: usize = 60;

/// What lines give.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Give {
    /// Poses of an object.
    Poses,
    /// Drives.
    Drives,
    /// Levels of the pins of these motors, in this order. Pins take so many ms to get there, unless a line says otherwise.
    Levels { motors: Vec<u8>, glide_ms: Option<f64> },
}

/// The lines of an open file.
#[derive(Debug)]
pub(super) struct Lines {
    input: File,
    is_file: bool,
    give: Give,
    bytes: Vec<u8>,
    /// How much of `bytes` was taken.
    taken: usize,
    count: u64,
    at_end: bool,
}

impl Lines {
    pub(super) fn stdin(give: Give) -> Result<Self> {
        let input = io::stdin().as_fd().try_clone_to_owned().context("stdin cannot be read")?;
        Self::of(input.into(), give)
    }

    fn of(input: File, give: Give) -> Result<Self> {
        let is_file = input.metadata().context("stdin cannot be read")?.is_file();
        Ok(Self { input, is_file, give, bytes: Vec::new(), taken: 0, count: 0, at_end: false })
    }

    /// Whether it is a regular file, which is never late.
    pub(super) const fn is_file(&self) -> bool {
        self.is_file
    }

    /// What a line may be.
    pub(super) fn wanted(&self) -> String {
        self.give.wanted()
    }

    /// Reads a piece; waits if there is none.
    pub(super) fn read(&mut self) -> Result<()> {
        self.bytes.drain(..std::mem::take(&mut self.taken));
        let mut piece = [0; PIECE];
        match self.input.read(&mut piece) {
            Ok(0) => self.at_end = true,
            Ok(read) => self.bytes.extend(&piece[..read]),
            Err(error) if matches!(error.kind(), io::ErrorKind::Interrupted | io::ErrorKind::WouldBlock) => {}
            Err(error) => bail!("stdin: cannot be read after line {} ({error})", self.count),
        }
        Ok(())
    }

    /// The message of the next line that was read, if there is one.
    pub(super) fn next(&mut self) -> Result<Option<LiveMessage>> {
        let rest = &self.bytes[self.taken..];
        let line = match rest.iter().position(|&byte| byte == b'\n') {
            Some(length) => &rest[..length],
            // The last line may lack its end.
            None if self.at_end && !rest.is_empty() => rest,
            None if rest.len() > MAX_LIVE_MESSAGE => rest,
            None => return Ok(None),
        };
        self.count += 1;
        let message =
            message(line, &self.give).map_err(|what| anyhow!("stdin: line {}: {what}", self.count))?;
        self.taken = (self.taken + line.len() + 1).min(self.bytes.len());
        Ok(Some(message))
    }

    /// Whether the input has ended and its last line was taken.
    pub(super) const fn is_over(&self) -> bool {
        self.at_end && self.taken == self.bytes.len()
    }
}

impl AsFd for Lines {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.input.as_fd()
    }
}

impl Give {
    fn wanted(&self) -> String {
        match self {
            Self::Drives => "write a JSON object".to_owned(),
            Self::Poses => "write X_MM Y_MM [DEGREES [DEPTH_UM]], or a JSON object".to_owned(),
            Self::Levels { motors, .. } => {
                let numbers: Vec<String> = motors.iter().map(u8::to_string).collect();
                format!("write a level in um for each of the motors {}, or a JSON object", numbers.join(","))
            }
        }
    }

    /// The keys of a line of numbers.
    fn keys_of(&self, text: &str) -> Option<Map<String, Value>> {
        let numbers = numbers(text)?;
        match self {
            Self::Poses | Self::Drives => {
                let pose = ["x_mm", "y_mm", "angle_deg", "depth_um"].into_iter().zip(&numbers);
                let pose: Map<String, Value> =
                    pose.map(|(key, value)| (key.to_owned(), json!(value))).collect();
                (2..=4).contains(&numbers.len()).then(|| Map::from_iter([("pose".to_owned(), pose.into())]))
            }
            Self::Levels { motors, .. } => {
                let um: BTreeMap<u8, f64> = motors.iter().copied().zip(numbers.iter().copied()).collect();
                (numbers.len() == motors.len()).then(|| Map::from_iter([("um".to_owned(), json!(um))]))
            }
        }
    }

    /// Refuses what the play does not take, and adds the glide.
    fn fitted(&self, message: LiveMessage) -> Result<LiveMessage, String> {
        let refused = match self {
            Self::Poses if message.drives.is_some() => {
                "the poses of the object decide: send a pose, or leave --object out"
            }
            Self::Drives | Self::Levels { .. } if message.pose.is_some() => {
                "a pose moves an object: name an --object, or send `drives`"
            }
            Self::Poses | Self::Drives if !message.um.is_empty() => {
                "`um` gives levels: name the motors with --levels, or send `drives`"
            }
            Self::Levels { glide_ms, .. } if !message.um.is_empty() => {
                return Ok(LiveMessage { glide_ms: message.glide_ms.or(*glide_ms), ..message });
            }
            _ => return Ok(message),
        };
        Err(refused.to_owned())
    }
}

/// Reads a line; an empty line gives a message that changes nothing. An error says what is wrong and what to do.
fn message(line: &[u8], give: &Give) -> Result<LiveMessage, String> {
    if line.len() > MAX_LIVE_MESSAGE {
        return Err("a line has more than 65536 bytes: write less".to_owned());
    }
    let text = std::str::from_utf8(line).map_err(|_| format!("not UTF-8 text: {}", give.wanted()))?;
    // Some programs put a byte order mark before the first line.
    let text = text.trim_start_matches('\u{feff}').trim();
    if text.is_empty() {
        return Ok(LiveMessage::default());
    }
    let quoted = || text.chars().take(QUOTED).collect::<String>().escape_debug().to_string();
    let keys = if text.starts_with('{') {
        let keys: Map<String, Value> = serde_json::from_str(text)
            .map_err(|error| format!("`{}` is not JSON ({error}): {}", quoted(), give.wanted()))?;
        if keys.contains_key("seq") {
            return Err("leave `seq` out: the command numbers its messages".to_owned());
        }
        keys
    } else {
        let what = if matches!(give, Give::Levels { .. }) { "levels" } else { "a pose" };
        give.keys_of(text).ok_or_else(|| format!("`{}` is not {what}: {}", quoted(), give.wanted()))?
    };
    let mut numbered = keys;
    numbered.insert("seq".to_owned(), json!(0));
    let message =
        LiveMessage::parse(Value::from(numbered).to_string().as_bytes()).map_err(|problem| problem.detail)?;
    give.fitted(message)
}

/// Finite numbers, all separated by blanks or all by commas, so that a missing column does not shift the others.
fn numbers(text: &str) -> Option<Vec<f64>> {
    let parts: Vec<&str> = if text.contains(',') {
        text.split(',').map(str::trim).collect()
    } else {
        text.split_whitespace().collect()
    };
    let number = |part: &str| part.parse().ok().filter(|number: &f64| number.is_finite());
    parts.into_iter().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::LivePose;
    use std::io::{Seek, Write};

    #[test]
    fn a_line_is_numbers_or_json() {
        let read = |line: &str| message(line.as_bytes(), &Give::Poses).unwrap();
        let pose = |x_mm, y_mm, angle_deg| {
            let pose = Some(LivePose { x_mm, y_mm, angle_deg, depth_um: None });
            LiveMessage { pose, ..LiveMessage::default() }
        };
        for line in [
            "1 -2.5 30",
            " 1\t-2.5  30\r",
            "1,-2.5,30",
            "1, -2.5 , 30",
            "{\"pose\":{\"x_mm\":1,\"y_mm\":-2.5,\"angle_deg\":30}}",
        ] {
            assert_eq!(read(line), pose(1.0, -2.5, 30.0), "{line}");
        }
        assert_eq!(read("0.5 1e-3"), pose(0.5, 0.001, 0.0));
        assert_eq!(read("{\"scale\":0.5}").scale, Some(0.5));
        assert!(read(" {\"end\": true} ").end);
        assert_eq!((read(""), read("{}")), Default::default());
    }

    #[test]
    fn a_bad_line_says_what_to_do() {
        for (line, says) in [
            ("1", "`1` is not a pose: write X_MM Y_MM [DEGREES [DEPTH_UM]], or a JSON object"),
            ("1 2 3 400 5", "`1 2 3 400 5` is not a pose"),
            ("0 0 0 2500", "`pose.depth_um` is 2500: must be 0 to 2000 um"),
            ("1,,2", "`1,,2` is not a pose"),
            ("1 2, 3", "is not a pose"),
            ("x y", "`x y` is not a pose"),
            ("nan 1", "is not a pose"),
            ("1 inf", "is not a pose"),
            ("25 0", "`pose.x_mm` is 25: must be -24 to 24 mm"),
            ("{\"pose\":", "is not JSON"),
            ("{\"seq\":3}", "leave `seq` out"),
            ("{\"psoe\":{}}", "did you mean `pose`?"),
            ("{\"scale\":2}", "`scale`"),
            ("{\"drives\":[]}", "leave --object out"),
        ] {
            let error = message(line.as_bytes(), &Give::Poses).unwrap_err();
            assert!(error.contains(says) && !error.contains('\n'), "{line}: {error}");
        }
        let deep = message(b"1 2 3 400", &Give::Poses).unwrap();
        assert_eq!(deep.pose.unwrap().depth_um, Some(400.0));
        assert!(message(b"1 2", &Give::Drives).unwrap_err().contains("name an --object"));
        assert!(message(b"\xff", &Give::Poses).unwrap_err().contains("UTF-8"));
        assert!(message(&[b'1'; MAX_LIVE_MESSAGE + 1], &Give::Poses).unwrap_err().contains("write less"));
    }

    #[test]
    fn a_line_of_levels_has_one_for_each_motor() {
        let give = Give::Levels { motors: vec![10, 9], glide_ms: Some(5.0) };
        let read = |line: &str| message(line.as_bytes(), &give);
        let levels = |um: [(u8, f64); 2], glide_ms| LiveMessage {
            um: um.into(),
            glide_ms: Some(glide_ms),
            ..LiveMessage::default()
        };
        for line in ["120 0.5", "120,0.5", "{\"um\":{\"9\":0.5,\"10\":120}}"] {
            assert_eq!(read(line), Ok(levels([(10, 120.0), (9, 0.5)], 5.0)), "{line}");
        }
        let own = "{\"um\":{\"9\":0.5,\"10\":120},\"glide_ms\":40}";
        assert_eq!(read(own), Ok(levels([(10, 120.0), (9, 0.5)], 40.0)));
        // What has no levels has no glide.
        assert_eq!((read(""), read("{\"scale\":0.5}").unwrap().glide_ms), (Ok(LiveMessage::default()), None));
        for (line, says) in [
            ("120", "`120` is not levels: write a level in um for each of the motors 10,9, or a JSON object"),
            ("1 2 3", "`1 2 3` is not levels"),
            ("1,", "is not levels"),
            ("1 -2", "`um.9` is -2: must be 0 um or more"),
            ("{\"pose\":{}}", "name an --object"),
        ] {
            let error = read(line).unwrap_err();
            assert!(error.contains(says), "{line}: {error}");
        }
        assert!(message(b"{\"um\":{\"9\":1}}", &Give::Drives).unwrap_err().contains("--levels"));
    }

    #[test]
    fn lines_are_numbered_and_the_last_one_needs_no_end() {
        let mut file = tempfile::tempfile().unwrap();
        write!(file, "1 1\n\n2 2\nx\n3 3").unwrap();
        file.rewind().unwrap();
        let mut lines = Lines::of(file, Give::Poses).unwrap();
        assert!(lines.is_file() && lines.next().unwrap().is_none());
        lines.read().unwrap();
        let x_mm = |lines: &mut Lines| lines.next().unwrap().unwrap().pose.map(|pose| pose.x_mm);
        assert_eq!([(); 3].map(|()| x_mm(&mut lines)), [Some(1.0), None, Some(2.0)]);
        let error = lines.next().unwrap_err().to_string();
        assert!(error.starts_with("stdin: line 4: `x` is not a pose"), "{error}");
        lines.taken += 2;
        assert!(lines.next().unwrap().is_none() && !lines.is_over(), "more may come");
        lines.read().unwrap();
        assert_eq!((x_mm(&mut lines), lines.is_over()), (Some(3.0), true));
    }

    #[test]
    fn a_line_without_end_is_an_error() {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&[b' '; MAX_LIVE_MESSAGE + PIECE]).unwrap();
        file.rewind().unwrap();
        let mut lines = Lines::of(file, Give::Poses).unwrap();
        let error = loop {
            lines.read().unwrap();
            if let Err(error) = lines.next() {
                break error.to_string();
            }
        };
        assert!(error.contains("line 1: a line has more than 65536 bytes"), "{error}");
    }
}
