//! Keys: what they do and how they are listed.
use super::mouse_hands::{Held, Motion};
use crate::picture::View;
use eframe::egui::{InputState, Key, Modifiers};

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Start, pause or go on.
    Go,
    /// End the session and keep it.
    Finish,
    /// Back to the beginning.
    Reset,
    /// End it and begin again.
    Retry,
    /// A saved view.
    View(View),
    /// The first person's view.
    FirstPerson,
    /// Look through the bone, or not.
    Transparent,
    /// Show the loads, or not.
    Loads,
    /// Show a head around, or not.
    Head,
    /// The next stereo mode.
    Stereo,
    /// Take hold of a chisel.
    Hold(Held),
    /// Bring it back to where it began.
    GoBack,
    /// Fill the screen, or not.
    FullScreen,
    /// List the keys, or not.
    Help,
    /// Close what lies over the window.
    Dismiss,
}

const CTRL: Modifiers = Modifiers::COMMAND;
const NONE: Modifiers = Modifiers::NONE;

/// Keys that command, as they are listed.
pub const COMMANDS: [(Modifiers, Key, Command, &str); 24] = [
    (NONE, Key::Space, Command::Go, "Start, pause, go on"),
    (
        NONE,
        Key::F4,
        Command::Finish,
        "End the session and keep it",
    ),
    (NONE, Key::F8, Command::Reset, "Back to the beginning"),
    (NONE, Key::F5, Command::Retry, "Try again"),
    (CTRL, Key::Num1, Command::View(View::Close), "View: close"),
    (
        CTRL,
        Key::Num2,
        Command::View(View::Procedure),
        "View: procedure",
    ),
    (CTRL, Key::Num3, Command::FirstPerson, "View: first person"),
    (CTRL, Key::Num4, Command::View(View::Front), "View: front"),
    (CTRL, Key::Num5, Command::View(View::Left), "View: left"),
    (CTRL, Key::Num6, Command::View(View::Right), "View: right"),
    (CTRL, Key::Num7, Command::View(View::Top), "View: top"),
    (NONE, Key::T, Command::Transparent, "Look through the bone"),
    (NONE, Key::L, Command::Loads, "Load arrows"),
    (NONE, Key::H, Command::Head, "Head around"),
    (NONE, Key::X, Command::Stereo, "Next stereo mode"),
    (NONE, Key::F11, Command::FullScreen, "Full screen"),
    (NONE, Key::F1, Command::Help, "This list"),
    (NONE, Key::Questionmark, Command::Help, ""),
    (
        NONE,
        Key::Escape,
        Command::Dismiss,
        "Close this; let go of the chisels",
    ),
    (
        NONE,
        Key::Num1,
        Command::Hold(Held::Left),
        "Hold the left chisel",
    ),
    (
        NONE,
        Key::Num2,
        Command::Hold(Held::Right),
        "Hold the right chisel",
    ),
    (
        NONE,
        Key::Num3,
        Command::Hold(Held::Both),
        "Hold both, mirrored",
    ),
    (
        NONE,
        Key::Num0,
        Command::Hold(Held::None),
        "Let go: the mouse turns the view",
    ),
    (
        NONE,
        Key::R,
        Command::GoBack,
        "Bring the held chisel back to its start",
    ),
];

/// What the mouse and keys that are held down do, as they are listed.
pub const GESTURES: [(&str, &str); 9] = [
    ("Drag", "Held chisel: move; none held: turn the view"),
    ("Shift + drag", "Twist the held chisel"),
    ("Ctrl + drag", "Pry with the held chisel"),
    ("Wheel", "Held chisel: drive in or out; none held: zoom"),
    ("Right drag, middle drag", "Turn the view, shift it"),
    ("Alt + wheel", "Zoom"),
    ("W  S", "Drive in, out"),
    ("A  D", "Twist"),
    ("Arrows, Q  E", "Move; pry"),
];

/// The commands of this frame.
pub fn commands(input: &mut InputState) -> Vec<Command> {
    let mut asked = Vec::new();
    // The question mark comes with whatever modifier the keyboard needs for it.
    if input.key_pressed(Key::Questionmark) {
        asked.push(Command::Help);
    }
    for (modifiers, key, command, _) in COMMANDS {
        if key != Key::Questionmark && input.consume_key(modifiers, key) {
            asked.push(command);
        }
    }
    asked
}

/// Speeds of keys held down \[mm/s, rad/s\].
const SPEEDS: [f64; 4] = [6.0, 0.35, 6.0, 0.2];

/// What keys held down move in this frame.
pub fn motion(input: &InputState) -> Motion {
    let dt = f64::from(input.stable_dt.min(0.25));
    let way = |plus: Key, minus: Key| {
        dt * (f64::from(u8::from(input.key_down(plus)))
            - f64::from(u8::from(input.key_down(minus))))
    };
    let [drive, twist, pan, pry] = SPEEDS;
    Motion {
        in_view: [
            pan * way(Key::ArrowRight, Key::ArrowLeft),
            pan * way(Key::ArrowUp, Key::ArrowDown),
        ],
        drive: drive * way(Key::W, Key::S),
        twist: twist * way(Key::A, Key::D),
        lever: [pry * way(Key::Q, Key::E), 0.0],
    }
}

/// A key as it is written on keyboards.
pub fn name(modifiers: Modifiers, key: Key) -> String {
    let prefix = if modifiers == CTRL { "Ctrl + " } else { "" };
    format!("{prefix}{}", key.name())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_means_two_things() {
        for (i, a) in COMMANDS.iter().enumerate() {
            for b in &COMMANDS[..i] {
                assert!((a.0, a.1) != (b.0, b.1), "{} and {}", a.3, b.3);
            }
        }
    }
}
