//! The wall clock and the time zone: the system's, or those of a bench.

use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use meissner_stream::time::{HostInstant, is_virtual};

/// The zone of a bench: the same on every machine, with daylight saving.
const VIRTUAL_ZONE: &str = "CET-1CEST,M3.5.0,M10.5.0/3";
/// The form of times: local, with the offset from UTC.
pub(crate) const LOCAL: &str = "%Y-%m-%dT%H:%M:%S%.6f%:z";

/// The local time zone.
pub(crate) fn zone() -> TimeZone {
    if is_virtual() { TimeZone::posix(VIRTUAL_ZONE).unwrap_or(TimeZone::UTC) } else { TimeZone::system() }
}

/// The same instant by both clocks.
pub(crate) fn now() -> (HostInstant, Timestamp) {
    let (monotonic, wall_ns) = HostInstant::now_with_wall();
    (monotonic, Timestamp::from_nanosecond(wall_ns.into()).unwrap_or_default())
}

/// Local time.
pub(crate) fn local() -> Zoned {
    now().1.to_zoned(zone())
}

/// Local time as texts have it.
pub(crate) fn local_text() -> String {
    local().strftime(LOCAL).to_string()
}

/// UTC, to the second.
pub(crate) fn utc_text() -> String {
    now().1.strftime("%FT%TZ").to_string()
}
