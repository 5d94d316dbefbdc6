//! The scene in the middle: the newest picture, what lies over it, and the mouse in it.
use super::app::Window;
use super::live::look;
use super::mouse_hands::{Held, Motion};
use super::{panels, planner, shortcuts, style, teacher};
use crate::picture::BACKGROUND;
use eframe::egui::{
    self, Align2, CentralPanel, Color32, FontId, Frame, Painter, PointerButton, Pos2, Rect, Rgba,
    Sense, Stroke, Ui, UiBuilder, Vec2, pos2, vec2,
};
use osteotome_render::Camera;

/// A pixel of mouse turns the view by so much \[rad\].
const TURN: f64 = 0.007;
/// A notch of the wheel drives a chisel by so much \[mm/point\].
const DRIVE: f64 = 0.02;
/// A pixel of mouse twists or pries a held chisel by so much \[rad\].
const TWIST: f64 = 0.005;

/// The whole of it.
pub fn centre(w: &mut Window, ui: &mut Ui) {
    let [r, g, b] = BACKGROUND[1];
    let ground: Color32 = Rgba::from_rgb(r, g, b).into();
    CentralPanel::default()
        .frame(Frame::new().fill(ground))
        .show(ui, |ui| {
            let rect = ui.available_rect_before_wrap();
            let response = ui.allocate_rect(rect, Sense::click_and_drag());
            response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "Scene"));
            if response.clicked() || response.drag_started() {
                ui.memory_mut(egui::Memory::stop_text_input);
            }
            mouse(w, ui, &response, rect);
            let scale = f64::from(ui.ctx().pixels_per_point());
            let pixels = |l: f32| (f64::from(l) * scale).round().clamp(16.0, 4096.0) as usize;
            w.look([pixels(rect.width()), pixels(rect.height())]);
            let painter = ui.painter_at(rect);
            if let Some(texture) = &w.view.texture {
                let whole = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
                painter.image(texture.id(), rect, whole, Color32::WHITE);
            }
            if let (Some(camera), None) = (&w.view.camera, w.settings.stereo) {
                scale_bar(&painter, rect, camera);
                orientation(&painter, rect, camera);
                teacher::plan(w, &painter, rect, camera);
            }
            held(w, &painter, rect);
            teacher::guide(w, ui, rect);
            planner::overlay(w, &painter, rect);
            let place = Rect::from_center_size(rect.center(), vec2(330.0, 90.0));
            ui.scope_builder(UiBuilder::new().max_rect(place), |ui| {
                panels::progress(w, ui);
            });
        });
}

fn mouse(w: &mut Window, ui: &Ui, response: &egui::Response, rect: Rect) {
    if planner::mouse(w, ui, response, rect) {
        return;
    }
    let held = w.hands.held != Held::None && w.hands.leads_any();
    let drag = response.drag_delta();
    let by = |button| response.dragged_by(button);
    let (modifiers, wheel) = ui.input(|i| (i.modifiers, i.smooth_scroll_delta().y));
    let wheel = if response.hovered() {
        f64::from(wheel)
    } else {
        0.0
    };
    let keys = if ui.ctx().text_edit_focused() {
        Motion::default()
    } else {
        ui.input(shortcuts::motion)
    };
    let turns = by(PointerButton::Secondary) || (by(PointerButton::Primary) && !held);
    let zooms = wheel != 0.0 && (!held || modifiers.alt);
    let Some(orbit) = &mut w.view.orbit else {
        return;
    };
    let mm = orbit.mm_per_pixel(f64::from(rect.height()));
    let [dx, dy] = [drag.x, drag.y].map(f64::from);
    if turns && drag != Vec2::ZERO {
        w.view.is_first_person = false;
        w.settings.view = None;
        orbit.turn(-TURN * dx, TURN * dy);
    }
    if by(PointerButton::Middle) {
        w.view.is_first_person = false;
        orbit.pan(-dx * mm, dy * mm);
    }
    if zooms {
        w.view.is_first_person = false;
        orbit.zoom((-0.002 * wheel).exp());
    }
    if !held {
        return;
    }
    let mut motion = keys;
    if by(PointerButton::Primary) {
        if modifiers.shift {
            motion.twist += TWIST * dx;
        } else if modifiers.command {
            motion.lever[0] += TWIST * dy;
            motion.lever[1] += TWIST * dx;
        } else {
            motion.in_view[0] += mm * dx;
            motion.in_view[1] -= mm * dy;
        }
    }
    if !zooms {
        motion.drive += DRIVE * wheel;
    }
    if motion != Motion::default() {
        let tools = look(&w.live).hands.map(|h| h.hands.map(|h| h.tool_pose));
        w.hands.go(&motion, orbit.axes(), tools);
    }
}

/// Which chisel the mouse holds.
fn held(w: &Window, painter: &Painter, rect: Rect) {
    if !w.hands.leads_any() {
        return;
    }
    let (text, color) = match w.hands.held {
        Held::None => ("Mouse: view", style::WEAK),
        Held::Left => ("Mouse: left chisel", style::of_hand(0)),
        Held::Right => ("Mouse: right chisel", style::of_hand(1)),
        Held::Both => ("Mouse: both chisels, mirrored", Color32::WHITE),
    };
    let at = rect.left_top() + vec2(14.0, 12.0);
    painter.text(
        at,
        Align2::LEFT_TOP,
        text,
        FontId::proportional(14.0),
        color,
    );
}

/// A round length of about a tenth of the picture; true where the camera looks at.
fn scale_bar(painter: &Painter, rect: Rect, camera: &Camera) {
    let points_per_mm = camera.half_heights_per_mm() * 0.5 * rect.height();
    let length = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]
        .into_iter()
        .rfind(|l| l * points_per_mm <= 110.0)
        .unwrap_or(1.0);
    let left = rect.left_bottom() + vec2(16.0, -16.0);
    let right = left + vec2(length * points_per_mm, 0.0);
    let stroke = Stroke::new(1.5, style::TEXT);
    for (a, b) in [
        (left, right),
        (left, left - vec2(0.0, 5.0)),
        (right, right - vec2(0.0, 5.0)),
    ] {
        painter.line_segment([a, b], stroke);
    }
    let text = format!("{length:.0} mm");
    let at = left + vec2(4.0, -5.0);
    painter.text(
        at,
        Align2::LEFT_BOTTOM,
        text,
        FontId::proportional(12.0),
        style::TEXT,
    );
}

/// The patient's axes: left, posterior and superior are +x, +y and +z. What points towards the eye is bright.
fn orientation(painter: &Painter, rect: Rect, camera: &Camera) {
    let centre = rect.right_bottom() - vec2(48.0, 48.0);
    let mut ends = Vec::new();
    for (k, pair) in [["L", "R"], ["P", "A"], ["S", "I"]].iter().enumerate() {
        for (name, sign) in pair.iter().zip([1.0, -1.0]) {
            let [right, up, forward] = camera.axes.map(|a| sign * a[k]);
            ends.push((forward, vec2(right, -up), *name));
        }
    }
    // The farthest first.
    ends.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (forward, way, name) in ends {
        let color = if forward < 0.25 {
            style::TEXT
        } else {
            style::LINE
        };
        let at = |r: f32| -> Pos2 { centre + way * r };
        painter.line_segment([centre, at(22.0)], Stroke::new(1.5, color));
        // A letter on an axis that points at the eye would cover the middle.
        if way.length() > 0.3 {
            let font = FontId::proportional(11.0);
            painter.text(at(31.0), Align2::CENTER_CENTER, name, font, color);
        }
    }
}
