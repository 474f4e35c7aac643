//! Braille: the dots of a character, and their places.
//!
//! Dots 1 to 3 are the left column of a cell from the top, 4 to 6 the right one. It knows the letters a to z and the six-dot
//! characters of Unicode, whose code gives their dots. It knows no words and no contractions.
//!
//! Invariant: every character found has a dot.

/// Letters a to j; other letters add dots 3 and 6 to these.
const FIRST_TEN: [u8; 10] = [
    0b00_0001, 0b00_0011, 0b00_1001, 0b01_1001, 0b01_0001, 0b00_1011, 0b01_1011, 0b01_0011, 0b00_1010,
    0b01_1010,
];
const DOT_3: u8 = 0b00_0100;
const DOT_6: u8 = 0b10_0000;

/// The dots of a letter a to z or a six-dot character, dot 1 in the lowest bit.
fn cell(character: char) -> Option<u8> {
    let ten = |index: u8| FIRST_TEN[usize::from(index)];
    match character {
        'a'..='j' => Some(ten(character as u8 - b'a')),
        'k'..='t' => Some(ten(character as u8 - b'k') | DOT_3),
        // Braille's French alphabet had no w: it was added later, out of order.
        'w' => Some(ten(b'j' - b'a') | DOT_6),
        'u' | 'v' => Some(ten(character as u8 - b'u') | DOT_3 | DOT_6),
        'x'..='z' => Some(ten(character as u8 - b'x' + 2) | DOT_3 | DOT_6),
        '\u{2801}'..='\u{283f}' => u8::try_from(u32::from(character) - 0x2800).ok(),
        _ => None,
    }
}

/// The dots of a character in a cell with this centre: their numbers, and their places in mm. None if `text` is not one letter a to z
/// or one six-dot character of Unicode.
pub fn dots(text: &str, pitch_mm: f64, center_mm: [f64; 2]) -> Option<Vec<(u8, [f64; 2])>> {
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

    #[test]
    fn every_letter_has_the_dots_of_its_unicode_character() {
        let braille = "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠅⠇⠍⠝⠕⠏⠟⠗⠎⠞⠥⠧⠺⠭⠽⠵";
        for (letter, character) in ('a'..='z').zip(braille.chars()) {
            assert_eq!(cell(letter), cell(character), "{letter}");
        }
        for not in ['A', ' ', '1', '\u{2800}', '\u{2840}', 'ä'] {
            assert_eq!(cell(not), None, "{not}");
        }
    }

    #[test]
    fn dots_are_numbered_down_the_left_column_then_the_right() {
        let dots_of = |text| dots(text, 2.0, [10.0, 0.0]);
        assert_eq!(dots_of("b"), Some(vec![(1, [9.0, 2.0]), (2, [9.0, 0.0])]));
        assert_eq!(dots_of("⠬"), Some(vec![(3, [9.0, -2.0]), (4, [11.0, 2.0]), (6, [11.0, -2.0])]));
        assert_eq!((dots_of(""), dots_of("ab")), (None, None));
    }
}
