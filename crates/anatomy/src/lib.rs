//! Files in, a validated patient out.
