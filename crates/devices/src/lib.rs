//! Haptic devices and their stand-ins.
