//! What can be trained, and who can lead a hand.
use crate::scenario::{self, Override, Scenario, Source};
use anyhow::Result;
use osteotome_devices::{Binding, Driver, HapticDevice};
use std::path::PathBuf;

/// Scenarios that come with the program: name in the settings, title, text.
pub const SHIPPED: [(&str, &str, &str); 4] = [
    ("bsso-right", "BSSO, right side", scenario::BSSO_RIGHT),
    ("bsso-left", "BSSO, left side", scenario::BSSO_LEFT),
    (
        "bsso-right-mouth",
        "BSSO, right side, through the mouth",
        scenario::BSSO_RIGHT_MOUTH,
    ),
    (
        "bsso-left-mouth",
        "BSSO, left side, through the mouth",
        scenario::BSSO_LEFT_MOUTH,
    ),
];

/// Where a scenario called so comes from: a shipped one, or a file.
pub fn source(name: &str) -> Source {
    match SHIPPED.iter().find(|s| s.0 == name) {
        Some((_, title, text)) => Source::Text {
            name: (*title).to_owned(),
            text: (*text).to_owned(),
        },
        None => Source::File(PathBuf::from(name)),
    }
}

/// As a picker shows it.
pub fn title(name: &str) -> String {
    match SHIPPED.iter().find(|s| s.0 == name) {
        Some((_, title, _)) => (*title).to_owned(),
        None => std::path::Path::new(name)
            .file_name()
            .map_or_else(|| name.to_owned(), |f| f.to_string_lossy().into_owned()),
    }
}

/// Reads and checks a scenario.
///
/// # Errors
/// One line: what is wrong, and where.
pub fn load(name: &str, overrides: &[Override]) -> Result<Scenario> {
    scenario::load(&source(name), overrides, &std::env::current_dir()?)
}

/// Who leads a hand, as the user picks it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Leading {
    /// The built-in surgeon.
    #[default]
    Surgeon,
    /// Mouse and keyboard.
    Mouse,
    /// A device.
    Device(Binding),
}

impl Leading {
    /// From the settings; what cannot be understood is the surgeon's.
    pub fn read(text: &str) -> Self {
        match text {
            "mouse" => Self::Mouse,
            _ => match text.parse() {
                Ok(binding) if binding != Binding::Simulated => Self::Device(binding),
                _ => Self::Surgeon,
            },
        }
    }

    /// For the settings.
    pub fn name(&self) -> String {
        match self {
            Self::Surgeon => "surgeon".to_owned(),
            Self::Mouse => "mouse".to_owned(),
            Self::Device(binding) => binding.to_string(),
        }
    }

    /// For the picker.
    pub fn title(&self) -> String {
        match self {
            Self::Surgeon => "Built-in surgeon".to_owned(),
            Self::Mouse => "Mouse and keyboard".to_owned(),
            Self::Device(binding) => format!("Device {binding}"),
        }
    }
}

/// Devices that drivers find now. Takes as long as drivers take to answer.
pub fn find_devices() -> Vec<Binding> {
    let of = |driver: Driver| {
        let devices = driver.connect().unwrap_or_default();
        devices.into_iter().map(move |d| {
            let serial = d.specification().serial.clone();
            Binding::Found {
                driver,
                serial: (!serial.is_empty()).then_some(serial),
            }
        })
    };
    Driver::ALL.into_iter().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ships_loads_and_who_leads_survives_the_settings() {
        for (name, title, _) in SHIPPED {
            assert_eq!(load(name, &[]).unwrap().name, title);
        }
        for text in ["surgeon", "mouse", "haply:049D", "remote:127.0.0.1:9870"] {
            assert_eq!(Leading::read(text).name(), text);
        }
        assert_eq!(Leading::read("phantom"), Leading::Surgeon);
        let missing = load("no/such.toml", &[]).unwrap_err().to_string();
        assert!(missing.contains("no/such.toml"), "{missing}");
    }
}
