//! A script in place of a user: `train --rehearse FILE` clicks, presses keys and takes screenshots through the same events as
//! mouse and keyboard. The window's tests and the pictures of the documentation come from it.
use crate::picture::write_png;
use anyhow::{Context as _, Result, bail};
use eframe::egui::{
    Color32, Context, Event, FullOutput, Key, Modifiers, MouseWheelUnit, PointerButton, Pos2,
    RawInput, Rect, ScreenshotCallback, TouchPhase, Vec2, ViewportCommand, plugin::Plugin, pos2,
    vec2,
};
use osteotome_render::Image;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What a line of the script says.
#[derive(Clone, Debug, PartialEq)]
enum Step {
    /// Until a text that contains this is on the window.
    Wait(String),
    /// Until none is.
    Gone(String),
    /// On what is labelled so.
    Click(String),
    /// Press and let go, with modifiers.
    Key(Modifiers, Key),
    /// Hold a key down for so many seconds.
    Hold(Key, f64),
    /// From a place, as shares of the window, by so many points.
    Drag(Modifiers, Pos2, Vec2),
    /// The wheel, at a place.
    Wheel(Pos2, f32),
    /// Do nothing for so many seconds.
    Rest(f64),
    /// Make the window so large.
    Size(Vec2),
    /// Write what is to be seen.
    Shot(PathBuf),
    /// Close the window.
    Quit,
}

/// What is waited for comes within this time, or the rehearsal fails.
const PATIENCE: Duration = Duration::from_secs(120);
/// A script is no longer \[bytes\].
const MOST_BYTES: u64 = 64 * 1024;

/// Where a failure is told once the window has closed.
#[derive(Clone, Default)]
pub struct Failed(Arc<Mutex<Option<String>>>);

impl Failed {
    /// What went wrong, once.
    pub fn take(&self) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn tell(&self, text: String) {
        let mut told = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        told.get_or_insert(text);
    }
}

/// See the module.
pub struct Rehearsal {
    steps: VecDeque<Step>,
    /// Texts and labels of the last frame, and where they are.
    nodes: Vec<(String, Rect)>,
    screen: Rect,
    /// When the step at hand began, and which of its frames this is.
    since: Option<Instant>,
    frame: u32,
    shot: Option<Arc<Mutex<Option<Result<()>>>>>,
    failed: Failed,
}

impl Rehearsal {
    /// Reads a script.
    ///
    /// # Errors
    /// A line that means nothing.
    pub fn read(path: &Path) -> Result<Self> {
        let named = || path.display().to_string();
        let length = std::fs::metadata(path).with_context(named)?.len();
        if length > MOST_BYTES {
            bail!(
                "{}: a script has at most {MOST_BYTES} bytes",
                path.display()
            );
        }
        let text = std::fs::read_to_string(path).with_context(named)?;
        let mut steps = VecDeque::new();
        for (n, line) in text.lines().enumerate() {
            let line = line.trim();
            if !line.is_empty() && !line.starts_with('#') {
                let step = step(line).with_context(|| format!("{}, line {}", named(), n + 1))?;
                steps.push_back(step);
            }
        }
        Ok(Self {
            steps,
            nodes: Vec::new(),
            screen: Rect::ZERO,
            since: None,
            frame: 0,
            shot: None,
            failed: Failed::default(),
        })
    }

    /// Where a failure will be told.
    pub fn failure(&self) -> Failed {
        self.failed.clone()
    }

    fn place(&self, label: &str) -> Option<Rect> {
        let ends = |text: &str| text == label || text.ends_with(&format!(" {label}"));
        self.nodes.iter().find(|n| ends(&n.0)).map(|n| n.1)
    }

    fn shows(&self, text: &str) -> bool {
        self.nodes.iter().any(|n| n.0.contains(text))
    }

    /// The step's events of this frame; true once it is done.
    fn play(&mut self, step: &Step, ctx: &Context, events: &mut Vec<Event>) -> bool {
        let lasted = self.since.get_or_insert_with(Instant::now).elapsed();
        let frame = self.frame;
        self.frame += 1;
        match step {
            Step::Wait(text) => self.shows(text),
            Step::Gone(text) => !self.shows(text),
            Step::Click(label) => match self.place(label) {
                Some(rect) => click(rect.center(), frame, events),
                None => {
                    self.frame = 0;
                    false
                }
            },
            Step::Key(modifiers, key) => {
                events.push(stroke(*key, frame == 0, *modifiers));
                frame > 0
            }
            Step::Hold(key, seconds) => {
                let is_over = lasted.as_secs_f64() > *seconds;
                events.push(stroke(*key, !is_over, Modifiers::NONE));
                is_over
            }
            Step::Drag(modifiers, from, by) => {
                let from = self.screen.lerp_inside(from.to_vec2());
                drag(from, *by, *modifiers, frame, events)
            }
            Step::Wheel(at, delta) => {
                events.push(Event::PointerMoved(self.screen.lerp_inside(at.to_vec2())));
                if frame == 1 {
                    events.push(wheel(*delta));
                }
                frame > 1
            }
            Step::Rest(seconds) => lasted.as_secs_f64() > *seconds,
            Step::Size(size) => {
                if frame == 0 {
                    ctx.send_viewport_cmd(ViewportCommand::InnerSize(*size));
                }
                // The window's manager may take its time.
                lasted > Duration::from_millis(400)
            }
            Step::Shot(path) => self.shoot(path, ctx),
            Step::Quit => {
                ctx.send_viewport_cmd(ViewportCommand::Close);
                true
            }
        }
    }

    fn shoot(&mut self, path: &Path, ctx: &Context) -> bool {
        let Some(shot) = &self.shot else {
            let done = Arc::<Mutex<Option<Result<()>>>>::default();
            self.shot = Some(done.clone());
            let path = path.to_owned();
            let callback = ScreenshotCallback::new(move |seen| {
                let image = Image {
                    width: seen.size[0],
                    height: seen.size[1],
                    pixels: seen.pixels.iter().map(Color32::to_array).collect(),
                };
                let written = write_png(&path, &image);
                *done.lock().unwrap_or_else(PoisonError::into_inner) = Some(written);
            });
            ctx.send_viewport_cmd(ViewportCommand::Screenshot(callback));
            return false;
        };
        let done = shot.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(done) = done else { return false };
        self.shot = None;
        if let Err(error) = done {
            self.failed.tell(format!("{error:#}"));
        }
        true
    }

    fn give_up(&mut self, step: &Step, ctx: &Context) {
        let seen: Vec<&str> = self.nodes.iter().map(|n| n.0.as_str()).collect();
        self.failed
            .tell(format!("still not {step:?}; there is {}", seen.join(" | ")));
        self.steps.clear();
        ctx.send_viewport_cmd(ViewportCommand::Close);
    }
}

impl Plugin for Rehearsal {
    fn debug_name(&self) -> &'static str {
        "rehearsal"
    }

    fn input_hook(&mut self, ctx: &Context, input: &mut RawInput) {
        self.screen = input.screen_rect.unwrap_or(self.screen);
        let Some(step) = self.steps.front().cloned() else {
            return;
        };
        // Whatever the window system tells of its own mouse would interfere.
        let is_pointer = |e: &Event| matches!(e, Event::PointerMoved(_) | Event::PointerGone);
        input.events.retain(|e| !is_pointer(e));
        if self.play(&step, ctx, &mut input.events) {
            self.steps.pop_front();
            self.since = None;
            self.frame = 0;
        } else if self.since.is_some_and(|s| s.elapsed() > PATIENCE) {
            self.give_up(&step, ctx);
        }
    }

    fn output_hook(&mut self, ctx: &Context, output: &mut FullOutput) {
        if let Some(update) = output.platform_output.accesskit_update.take() {
            let text = |n: &eframe::egui::accesskit::Node| {
                n.label().or_else(|| n.value()).map(str::to_owned)
            };
            let place = |n: &eframe::egui::accesskit::Node| {
                let b = n.bounds()?;
                let at = |x: f64, y: f64| pos2(x as f32, y as f32);
                Some(Rect::from_min_max(at(b.x0, b.y0), at(b.x1, b.y1)))
            };
            let nodes = update.nodes.iter();
            self.nodes = nodes
                .filter_map(|(_, n)| Some((text(n)?, place(n)?)))
                .collect();
        }
        if !self.steps.is_empty() {
            ctx.request_repaint_after(Duration::from_millis(15));
        }
    }
}

fn click(at: Pos2, frame: u32, events: &mut Vec<Event>) -> bool {
    match frame {
        0 | 1 => events.push(Event::PointerMoved(at)),
        2 | 3 => events.push(press(at, frame == 2, Modifiers::NONE)),
        _ => {}
    }
    frame >= 4
}

/// In ten steps.
fn drag(from: Pos2, by: Vec2, modifiers: Modifiers, frame: u32, events: &mut Vec<Event>) -> bool {
    const STEPS: u32 = 10;
    match frame {
        0 => events.extend([
            Event::ModifiersChanged(modifiers),
            Event::PointerMoved(from),
        ]),
        1 => events.push(press(from, true, modifiers)),
        f if f <= STEPS + 1 => {
            let share = (f - 1) as f32 / STEPS as f32;
            events.push(Event::PointerMoved(from + by * share));
        }
        _ => events.extend([
            press(from + by, false, modifiers),
            Event::ModifiersChanged(Modifiers::NONE),
        ]),
    }
    frame > STEPS + 1
}

fn press(pos: Pos2, pressed: bool, modifiers: Modifiers) -> Event {
    Event::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers,
    }
}

fn stroke(key: Key, pressed: bool, modifiers: Modifiers) -> Event {
    Event::Key {
        key,
        physical_key: None,
        pressed,
        repeat: false,
        modifiers,
    }
}

fn wheel(points: f32) -> Event {
    Event::MouseWheel {
        unit: MouseWheelUnit::Point,
        delta: vec2(0.0, points),
        phase: TouchPhase::Move,
        source: eframe::egui::MouseWheelSource::Unknown,
        modifiers: Modifiers::NONE,
    }
}

fn step(line: &str) -> Result<Step> {
    let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
    let rest = rest.trim();
    let text = || match rest {
        "" => bail!("`{word}` wants a text"),
        text => Ok(text.to_owned()),
    };
    let numbers = |from: usize, n: usize| -> Result<Vec<f32>> {
        let numbers: Result<Vec<f32>, _> =
            rest.split_whitespace().skip(from).map(str::parse).collect();
        match numbers {
            Ok(list) if list.len() == n && list.iter().all(|v| v.is_finite()) => Ok(list),
            _ => bail!("`{word}` wants {n} numbers"),
        }
    };
    Ok(match word {
        "wait" => Step::Wait(text()?),
        "gone" => Step::Gone(text()?),
        "click" => Step::Click(text()?),
        "key" => {
            let (modifiers, key) = key(rest)?;
            Step::Key(modifiers, key)
        }
        "hold" => {
            let (_, key) = key(rest.split(' ').next().unwrap_or_default())?;
            Step::Hold(key, numbers(1, 1)?[0].into())
        }
        "drag" => drag_step(Modifiers::NONE, &numbers(0, 4)?),
        "shift-drag" => drag_step(Modifiers::SHIFT, &numbers(0, 4)?),
        "wheel" => {
            let n = numbers(0, 3)?;
            Step::Wheel(pos2(n[0], n[1]), n[2])
        }
        "rest" => Step::Rest(numbers(0, 1)?[0].into()),
        "size" => {
            let n = numbers(0, 2)?;
            Step::Size(vec2(n[0], n[1]))
        }
        "shot" => Step::Shot(text()?.into()),
        "quit" => Step::Quit,
        _ => bail!(
            "`{word}` is none of wait, gone, click, key, hold, drag, shift-drag, wheel, rest, size, shot, quit"
        ),
    })
}

fn drag_step(modifiers: Modifiers, n: &[f32]) -> Step {
    Step::Drag(modifiers, pos2(n[0], n[1]), vec2(n[2], n[3]))
}

fn key(text: &str) -> Result<(Modifiers, Key)> {
    let (modifiers, name) = match text.strip_prefix("Ctrl+") {
        Some(name) => (Modifiers::COMMAND, name),
        None => (Modifiers::NONE, text),
    };
    let key = Key::from_name(name).with_context(|| format!("there is no key `{text}`"))?;
    Ok((modifiers, key))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_are_read_and_nonsense_is_refused() {
        assert_eq!(step("wait Ready").unwrap(), Step::Wait("Ready".into()));
        let key = Step::Key(Modifiers::COMMAND, Key::Num3);
        assert_eq!(step("key Ctrl+3").unwrap(), key);
        let drag = Step::Drag(Modifiers::NONE, pos2(0.5, 0.4), vec2(30.0, -2.0));
        assert_eq!(step("drag 0.5 0.4 30 -2").unwrap(), drag);
        for line in ["jump", "wait", "key Foo", "drag 1 2 3", "rest nan"] {
            assert!(step(line).is_err(), "{line}");
        }
    }
}
