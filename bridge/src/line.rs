//! Capacity of a serial line, from its address.

/// Share of a line for the loop, where heartbeats, requests, time synchronisation or a ground station use it
/// as well.
pub(crate) const COMMON_SHARE: f64 = 0.8;

/// Baud rate and bits per byte of a serial line; `None` for another link. The address is
/// `serial://PATH:BAUD`, followed by `:8E2` for two stop bits and a parity.
pub(crate) fn serial_line(link: &str) -> Option<(f64, f64)> {
    let address = link.strip_prefix("serial://")?;
    let (address, bits) = address.strip_suffix(":8E2").map_or((address, 10.0), |rest| (rest, 12.0));
    let address = address.strip_suffix(":8N1").unwrap_or(address);
    let baud: f64 = address.rsplit_once(':')?.1.parse().ok()?;
    (baud > 0.0).then_some((baud, bits))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_its_rate_and_format() {
        assert_eq!(serial_line("serial:///dev/ttyUSB0:100000:8E2"), Some((100_000.0, 12.0)));
        assert_eq!(serial_line("serial:///dev/ttyACM0:57600"), Some((57_600.0, 10.0)));
        assert_eq!(serial_line("udpin://0.0.0.0:14550"), None);
    }
}
