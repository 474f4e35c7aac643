//! Braille: which of a cell's six dots a character has, and where they lie.
//!
//! Dots 1 to 3 are the left column from the top, 4 to 6 the right one. Only letters, and the six-dot characters of
//! Unicode, which are their own pattern. No words, no contractions.
//!
//! Invariant: a cell that exists has a dot.

/// Letters a to j; the others are these with dots added below.
const FIRST_TEN: [u8; 10] = [
    0b00_0001, 0b00_0011, 0b00_1001, 0b01_1001, 0b01_0001, 0b00_1011, 0b01_1011, 0b01_0011, 0b00_1010,
    0b01_1010,
];
const DOT_3: u8 = 0b00_0100;
const DOT_6: u8 = 0b10_0000;

/// The dots of a character, the lowest bit dot 1; none if it is no letter a to z and no six-dot character.
fn cell(character: char) -> Option<u8> {
    let ten = |index: u8| FIRST_TEN[usize::from(index)];
    match character {
        'a'..='j' => Some(ten(character as u8 - b'a')),
        'k'..='t' => Some(ten(character as u8 - b'k') | DOT_3),
        // Braille is older than English: w was added to a French alphabet that went u, v, x, y, z.
        'w' => Some(ten(b'j' - b'a') | DOT_6),
        'u' | 'v' => Some(ten(character as u8 - b'u') | DOT_3 | DOT_6),
        'x'..='z' => Some(ten(character as u8 - b'x' + 2) | DOT_3 | DOT_6),
        '\u{2801}'..='\u{283f}' => u8::try_from(u32::from(character) - 0x2800).ok(),
        _ => None,
    }
}

/// The dots of a character with their numbers, in mm; none if `text` is not one that is known.
pub(super) fn dots(text: &str, pitch_mm: f64, center_mm: [f64; 2]) -> Option<Vec<(u8, [f64; 2])>> {
    let mut characters = text.chars();
    let (Some(character), None) = (characters.next(), characters.next()) else { return None };
    let cell = cell(character)?;
    let place = |dot: u8| {
        let (column, row) = (f64::from(dot / 3), f64::from(dot % 3));
        [center_mm[0] + (column - 0.5) * pitch_mm, center_mm[1] + (1.0 - row) * pitch_mm]
    };
    Some((0..6).filter(|dot| cell >> dot & 1 == 1).map(|dot| (dot + 1, place(dot))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unicode has the alphabet's cells too, in no order that we used.
    #[test]
    fn every_letter_is_its_unicode_character() {
        let braille = "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠅⠇⠍⠝⠕⠏⠟⠗⠎⠞⠥⠧⠺⠭⠽⠵";
        for (letter, character) in ('a'..='z').zip(braille.chars()) {
            assert_eq!(cell(letter), cell(character), "{letter}");
        }
        for not in ['A', ' ', '1', '\u{2800}', '\u{2840}', 'ä'] {
            assert_eq!(cell(not), None, "{not}");
        }
    }

    #[test]
    fn dots_are_numbered_down_the_left_and_then_down_the_right() {
        let dots_of = |text| dots(text, 2.0, [10.0, 0.0]);
        assert_eq!(dots_of("b"), Some(vec![(1, [9.0, 2.0]), (2, [9.0, 0.0])]));
        assert_eq!(dots_of("⠬"), Some(vec![(3, [9.0, -2.0]), (4, [11.0, 2.0]), (6, [11.0, -2.0])]));
        assert_eq!((dots_of(""), dots_of("ab")), (None, None));
    }
}
