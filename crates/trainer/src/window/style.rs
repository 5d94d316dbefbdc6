//! How the window looks: dark, quiet, the loads in the colours that they have in the scene.
use crate::picture::LOAD_LETTERS;
use eframe::egui::{
    self, Color32, Context, CornerRadius, FontFamily, FontId, Stroke, TextStyle, Theme, vec2,
};

/// Behind panels.
pub const PANEL: Color32 = Color32::from_rgb(24, 28, 34);
/// Behind groups within them.
pub const CARD: Color32 = Color32::from_rgb(32, 37, 45);
/// Behind plots and gauges.
pub const WELL: Color32 = Color32::from_rgb(17, 20, 25);
/// Lines between.
pub const LINE: Color32 = Color32::from_rgb(52, 59, 70);
/// Letters.
pub const TEXT: Color32 = Color32::from_rgb(218, 224, 232);
/// Letters of less weight.
pub const WEAK: Color32 = Color32::from_rgb(146, 156, 170);
/// What is chosen.
pub const ACCENT: Color32 = Color32::from_rgb(62, 118, 186);
/// All is well.
pub const GOOD: Color32 = Color32::from_rgb(92, 190, 120);
/// Look out.
pub const FAIR: Color32 = Color32::from_rgb(232, 190, 74);
/// Too much.
pub const BAD: Color32 = Color32::from_rgb(232, 92, 84);

/// The hand's colour, left first.
pub fn of_hand(i: usize) -> Color32 {
    let [r, g, b] = LOAD_LETTERS[i];
    Color32::from_rgb(r, g, b)
}

/// Green, yellow from half of the limit, red from four fifths: the colours flow into each other.
pub fn of_share(share: f64) -> Color32 {
    let share = share as f32;
    if share < 0.65 {
        GOOD.lerp_to_gamma(FAIR, ((share - 0.4) / 0.25).clamp(0.0, 1.0))
    } else {
        FAIR.lerp_to_gamma(BAD, ((share - 0.65) / 0.2).clamp(0.0, 1.0))
    }
}

/// Sets it up.
pub fn set(ctx: &Context) {
    ctx.set_theme(Theme::Dark);
    ctx.all_styles_mut(|style| {
        let font = |size: f32| FontId::new(size, FontFamily::Proportional);
        style.text_styles = [
            (TextStyle::Small, font(11.0)),
            (TextStyle::Body, font(13.0)),
            (TextStyle::Button, font(13.0)),
            (TextStyle::Heading, font(17.0)),
            (
                TextStyle::Monospace,
                FontId::new(12.0, FontFamily::Monospace),
            ),
        ]
        .into();
        style.spacing.item_spacing = vec2(8.0, 6.0);
        style.spacing.button_padding = vec2(9.0, 4.0);
        style.spacing.interact_size.y = 24.0;
        colors(&mut style.visuals);
    });
}

fn colors(v: &mut egui::Visuals) {
    v.panel_fill = PANEL;
    v.window_fill = CARD;
    v.window_stroke = Stroke::new(1.0, LINE);
    v.extreme_bg_color = WELL;
    v.faint_bg_color = CARD;
    v.weak_text_color = Some(WEAK);
    v.selection.bg_fill = ACCENT;
    v.selection.stroke = Stroke::new(1.0, Color32::WHITE);
    let round = CornerRadius::same(5);
    let w = &mut v.widgets;
    for (state, fill, text) in [
        (&mut w.noninteractive, PANEL, TEXT),
        (&mut w.inactive, Color32::from_rgb(46, 53, 64), TEXT),
        (
            &mut w.hovered,
            Color32::from_rgb(60, 70, 84),
            Color32::WHITE,
        ),
        (&mut w.active, ACCENT, Color32::WHITE),
        (&mut w.open, Color32::from_rgb(46, 53, 64), TEXT),
    ] {
        state.corner_radius = round;
        state.bg_fill = fill;
        state.weak_bg_fill = fill;
        state.fg_stroke = Stroke::new(1.0, text);
        state.bg_stroke = Stroke::NONE;
    }
    w.noninteractive.bg_stroke = Stroke::new(1.0, LINE);
}
