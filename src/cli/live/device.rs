//! Finds and opens an input device, and reads its events.
//!
//! Invariant: opening and reading do not change the device; other programs still get its events.

use super::follower::{Follower, Range};
use anyhow::{Context, Result, anyhow, bail};
use evdev::{AbsoluteAxisCode, Device, RelativeAxisCode};
use meissner_api::LivePose;
use meissner_client::access::{CurrentUser, UserGroup, join_command};
use std::fs::{self, File};
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::{Path, PathBuf};

/// Where the system has its input devices.
const DEVICES: &str = "/dev/input";

/// An open device and its file.
pub(super) type Opened = (PathBuf, Device);

/// An input device that is followed.
#[derive(Debug)]
pub(super) struct Input {
    path: PathBuf,
    device: Device,
    follower: Follower,
}

impl Input {
    /// Opens the first mouse.
    pub(super) fn mouse() -> Result<Opened> {
        let is_mouse = |device: &Device| {
            device.supported_relative_axes().is_some_and(|axes| {
                axes.contains(RelativeAxisCode::REL_X) && axes.contains(RelativeAxisCode::REL_Y)
            })
        };
        let mice = evdev::enumerate().filter(|(_, device)| is_mouse(device));
        // The system lists them in no order; sort so that `event10` comes after `event9`.
        let first = mice.min_by_key(|(path, _)| (path.as_os_str().len(), path.clone()));
        first.ok_or_else(|| no_mouse(Path::new(DEVICES)))
    }

    /// Opens the device at `path`.
    pub(super) fn open(path: &Path) -> Result<Opened> {
        let device = Device::open(path).map_err(|error| match error.kind() {
            io::ErrorKind::PermissionDenied => anyhow!("{}: you may not read it: {}", path.display(), join()),
            _ => anyhow!(
                "{}: cannot be opened as an input device ({error}): name one of {DEVICES}/event*",
                path.display()
            ),
        })?;
        Ok((path.to_owned(), device))
    }

    /// Follows an open device; poses stay within `most_mm` of the middle, along x and y.
    pub(super) fn new((path, device): Opened, mm_per_count: f64, most_mm: [f64; 2]) -> Result<Self> {
        let has = |axis| device.supported_relative_axes().is_some_and(|axes| axes.contains(axis));
        let followed = [
            RelativeAxisCode::REL_X,
            RelativeAxisCode::REL_Y,
            RelativeAxisCode::REL_WHEEL,
            RelativeAxisCode::REL_DIAL,
        ];
        let axes = [AbsoluteAxisCode::ABS_X, AbsoluteAxisCode::ABS_Y];
        let read = |device: &Device| -> io::Result<_> {
            device.set_nonblocking(true)?;
            // A device without absolute axes cannot be asked for their state.
            if device.supported_absolute_axes().is_none() {
                return Ok([None; 2]);
            }
            let all: Vec<_> = device.get_absinfo()?.collect();
            Ok(axes.map(|axis| all.iter().find(|(found, _)| *found == axis).map(|(_, info)| *info)))
        };
        let found = read(&device).with_context(|| format!("{}: its axes cannot be read", path.display()))?;
        if found.iter().all(Option::is_none) && !followed.into_iter().any(has) {
            bail!(
                "{}: has no axis to follow: name a mouse, a knob, a touchpad or a tablet of {DEVICES}/event*",
                path.display()
            );
        }
        let ranges = found.map(|info| info.map(|info| Range { least: info.minimum(), most: info.maximum() }));
        let mut follower = Follower::new(mm_per_count, most_mm, ranges);
        let [x, y] = found.map(|info| info.map(|info| info.value()));
        follower.place(x, y);
        Ok(Self { path, device, follower })
    }

    /// Takes the events that have come.
    pub(super) fn read(&mut self) -> Result<()> {
        let Self { path, device, follower } = self;
        match device.fetch_events() {
            Ok(events) => events.for_each(|event| follower.hear(event)),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {}
            Err(error) => {
                bail!("{}: the device is gone ({error}): connect it, then start again", path.display())
            }
        }
        Ok(())
    }

    /// Where the shape is.
    pub(super) const fn pose(&self) -> LivePose {
        self.follower.pose()
    }

    /// Its file and its name.
    pub(super) fn shown(&self) -> String {
        let name = self.device.name().unwrap_or("no name").escape_debug();
        format!("{} ({name})", self.path.display())
    }
}

impl AsFd for Input {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.device.as_fd()
    }
}

/// Why there is no mouse, and what to do.
fn no_mouse(devices: &Path) -> anyhow::Error {
    let paths = fs::read_dir(devices).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_denied =
        |path: PathBuf| File::open(path).is_err_and(|error| error.kind() == io::ErrorKind::PermissionDenied);
    if paths.filter(|path| !path.is_dir()).any(is_denied) {
        return anyhow!("no mouse that you may read: {}; or name a device with --follow evdev:PATH", join());
    }
    anyhow!("no mouse in {}: connect one, or name a device with --follow evdev:PATH", devices.display())
}

/// How to get access to input devices.
fn join() -> String {
    match (CurrentUser::look_up(), UserGroup::named("input")) {
        (Some(me), Some(group)) => join_command(&me, &group),
        _ => {
            "have your administrator add you to the group of /dev/input/event*, then log in again".to_owned()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// This machine may have no input device; `follower` tests events.
    #[test]
    fn without_a_mouse_the_error_says_what_to_do() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("event0"), "").unwrap();
        let line = no_mouse(dir.path()).to_string();
        let says = format!("no mouse in {}: connect one, or name a device", dir.path().display());
        assert!(line.starts_with(&says), "{line}");
        assert!(!join().is_empty() && !join().contains('\n'));
    }

    #[test]
    fn a_file_that_is_no_input_device_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("event0");
        fs::write(&path, "").unwrap();
        let line = Input::open(&path).unwrap_err().to_string();
        assert!(
            line.starts_with(&format!("{}: cannot be opened as an input device (", path.display())),
            "{line}"
        );
    }
}
