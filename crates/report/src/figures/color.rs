//! Colours for numbers: from dark blue over green to yellow, after viridis. Brightness rises with the number, so the
//! scale is readable in grey.
//!
//! Invariant: a share outside 0 to 1 has the colour of the nearer end.

/// Viridis at equal steps.
const STOPS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];
/// From this brightness on, black text is more readable than white.
const BRIGHT: f64 = 0.55;

/// The colour of a share of the scale, 0 to 1.
pub(super) fn color(share: f64) -> String {
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let below = place.floor().min((STOPS.len() - 2) as f64);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 3")]
    let (from, to) = (STOPS[below as usize], STOPS[below as usize + 1]);
    let mix = |channel: usize| (from[channel] + (to[channel] - from[channel]) * (place - below)).round();
    format!("rgb({},{},{})", mix(0), mix(1), mix(2))
}

/// The colour of text on it.
pub(super) fn ink(share: f64) -> &'static str {
    if share < BRIGHT { "#ffffff" } else { "#000000" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_is_clamped_at_its_ends() {
        assert_eq!((color(-1.0), color(2.0)), ("rgb(68,1,84)".to_owned(), "rgb(253,231,37)".to_owned()));
        assert_eq!(color(0.125), "rgb(64,42,112)");
        assert_eq!((ink(0.0), ink(1.0)), ("#ffffff", "#000000"));
    }
}
