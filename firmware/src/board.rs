//! The board: pins and USB names. Change this table for another wiring.
//!
//! One word holds all outputs: bit n is GPIO n. A word of zero is all outputs low. GPIO 23 and 24 belong to the Pico's
//! supply; 25 is its LED.

use crate::array::{LAYOUT, TRIGGER_IS_INPUT};
use firmware_protocol::board::{Output, Outputs};

/// Lines of the board that are in use.
pub(crate) const MOTORS: usize = LAYOUT.motors();

/// The GPIO of each line that the board has. Line m drives motor m; an array with fewer motors uses the first ones.
const LINES: [u8; 24] =
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 26];
const _: () = assert!(MOTORS <= LINES.len(), "the array has more motors than the board has lines");
/// Rises with the first tick of a play, for example for an EEG amplifier. With [`TRIGGER_IS_INPUT`] it is the trigger input.
pub(crate) const TRIGGER: u8 = 27;
/// The trigger input: the first line that no motor has, or GPIO 27 instead of the trigger output.
pub(crate) const TRIGGER_INPUT: Option<u8> =
    if TRIGGER_IS_INPUT { Some(TRIGGER) } else { LINES.split_at(MOTORS).1.first().copied() };
/// Enables the bridges of all LT3572 drivers: high only around bursts.
pub(crate) const ENABLE: u8 = 28;
/// The Pico's LED: lit while armed or returning.
const LED: u8 = 25;
/// The bit of the drivers' enable.
pub(crate) const ENABLED: u32 = 1 << ENABLE;
/// The bit of the LED.
pub(crate) const ARMED: u32 = 1 << LED;
/// The bit of the trigger output, if there is one.
pub(crate) const TRIGGERED: u32 = if TRIGGER_IS_INPUT { 0 } else { 1 << TRIGGER };
/// All outputs, in the order in which they are forced low: the drivers' supply first.
pub(crate) const OUTPUTS: [u8; DRIVEN + 2] = {
    let mut all = [0; DRIVEN + 2];
    (all[0], all[1]) = (ENABLE, LED);
    let mut output = 0;
    while output < DRIVEN {
        all[2 + output] = driven(output);
        output += 1;
    }
    all
};
/// The outputs that the self-test drives: the lines, and the trigger output if there is one.
pub(crate) const DRIVEN: usize = MOTORS + if TRIGGER_IS_INPUT { 0 } else { 1 };

/// USB vendor: pid.codes.
pub(crate) const VENDOR: u16 = 0x1209;
/// USB product: the number of pid.codes for tests. Get your own to ship boards.
pub(crate) const PRODUCT: u16 = 0x0001;
/// Name of the product. The host looks for this name.
pub(crate) const NAME: &str = "meissner";

/// Names the vendor interface to programs on Windows, which find the device by it.
pub(crate) const INTERFACE_GUIDS: &[&str] = &["{DA31CC97-0C7D-4D4D-A0F0-699E524D86CA}"];

/// The GPIOs for each value of each byte of a mask of lines.
static GPIOS: [[u32; 256]; 3] = {
    let mut table = [[0; 256]; 3];
    let mut byte = 0;
    while byte < 256 {
        let mut bit = 0;
        while bit < 8 {
            if byte >> bit & 1 == 1 {
                let mut third = 0;
                while third < 3 {
                    if 8 * third + bit < MOTORS {
                        table[third][byte] |= 1 << LINES[8 * third + bit];
                    }
                    third += 1;
                }
            }
            bit += 1;
        }
        byte += 1;
    }
    table
};

/// The output of the self-test with this number: a line, or the trigger after them.
pub(crate) const fn driven(number: usize) -> u8 {
    if number < MOTORS { LINES[number] } else { TRIGGER }
}

/// The outputs of a word of GPIOs.
pub(crate) fn outputs(gpios: u32) -> Outputs {
    let mut outputs =
        Outputs { trigger: gpios & TRIGGERED != 0, enable: gpios >> ENABLE & 1 == 1, ..Outputs::NONE };
    for (line, gpio) in LINES.iter().take(MOTORS).enumerate() {
        if gpios >> gpio & 1 == 1 {
            outputs.lines.insert(line as u8);
        }
    }
    outputs
}

/// The number of a GPIO's output in a word that [`outputs`] reads, as the protocol has it.
pub(crate) fn output(gpio: u8) -> Output {
    match gpio {
        TRIGGER => Output::Trigger,
        ENABLE => Output::Enable,
        _ => Output::Line(LINES.iter().position(|&line| line == gpio).unwrap_or(0) as u8),
    }
}

/// The GPIOs of all outputs that the self-test reads.
pub(crate) const READ: u32 = {
    let (mut word, mut line) = (ENABLED | TRIGGERED, 0);
    while line < MOTORS {
        word |= 1 << LINES[line];
        line += 1;
    }
    word
};

/// The GPIOs of a mask of lines.
pub(crate) fn gpios(lines: u32) -> u32 {
    let [a, b, c, _] = lines.to_le_bytes();
    GPIOS[0][usize::from(a)] | GPIOS[1][usize::from(b)] | GPIOS[2][usize::from(c)]
}
