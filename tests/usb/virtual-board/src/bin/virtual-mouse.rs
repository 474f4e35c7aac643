//! A mouse of software: `virtual-mouse`. Each line of stdin moves it: counts to the right, counts towards the person, notches of the wheel.
//! At the end of stdin it is unplugged.

use evdev::uinput::VirtualDevice;
use evdev::{AttributeSet, EventType, InputEvent, KeyCode, RelativeAxisCode};
use std::error::Error;
use std::io;

const AXES: [RelativeAxisCode; 3] =
    [RelativeAxisCode::REL_X, RelativeAxisCode::REL_Y, RelativeAxisCode::REL_WHEEL];

fn main() -> Result<(), Box<dyn Error>> {
    let axes: AttributeSet<RelativeAxisCode> = AXES.into_iter().collect();
    let buttons: AttributeSet<KeyCode> = [KeyCode::BTN_LEFT].into_iter().collect();
    let builder = VirtualDevice::builder()?.name("virtual mouse");
    let mut mouse = builder.with_relative_axes(&axes)?.with_keys(&buttons)?.build()?;
    println!("plugged in");
    for line in io::stdin().lines() {
        let counts: Vec<i32> = line?.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let moved = AXES.iter().zip(counts).filter(|(_, count)| *count != 0);
        let events: Vec<InputEvent> =
            moved.map(|(axis, count)| InputEvent::new(EventType::RELATIVE.0, axis.0, count)).collect();
        mouse.emit(&events)?;
    }
    Ok(())
}
