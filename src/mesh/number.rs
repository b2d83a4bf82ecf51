//! Decimal numbers from bytes, rounded exactly as the standard library does, but without its UTF-8 and general cases first.
//!
//! The fast path is Clinger's ("How to Read Floating Point Numbers Accurately", PLDI 1990): a mantissa below 2^53 and a
//! power of ten up to 22 are exact in `f64`, so one operation rounds once. The second rounding, to `f32`, is safe unless
//! the first ended exactly halfway between two `f32`s; then, and for anything unusual, the standard parser decides.

/// Powers of ten that `f64` holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// The `f32` nearest to a decimal number, as `str::parse` has it; also with a Fortran exponent
/// (`1.0D+00`) or a decimal comma (`0,5`). `None` for everything else.
#[inline]
pub fn parse_f32(token: &[u8]) -> Option<f32> {
    fast(token).or_else(|| {
        let text = std::str::from_utf8(token).ok()?;
        text.parse().ok().or_else(|| foreign(text)?.parse().ok())
    })
}

/// The number in the usual letters, when other programs' letters stand in it.
#[cold]
fn foreign(text: &str) -> Option<String> {
    let usual = text.strip_prefix(['-', '+']).unwrap_or(text);
    let digits = usual.starts_with(|c: char| c.is_ascii_digit() || c == '.' || c == ',');
    let commas = usual.matches(',').count();
    if !digits || commas > 1 || commas == 1 && usual.contains('.') {
        return None;
    }
    Some(text.replace(',', ".").replacen(['d', 'D'], "e", 1))
}

#[inline]
fn fast(token: &[u8]) -> Option<f32> {
    let (negative, digits) = match token {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, token),
    };
    // 19 digits fit in a u64; a longer token goes the standard way.
    if digits.is_empty() || digits.len() > 20 {
        return None;
    }
    let mut mantissa = 0_u64;
    let mut count = 0_usize;
    let mut fraction = 0_i32;
    let mut seen_point = false;
    let mut at = 0;
    while at < digits.len() {
        let byte = digits[at];
        let digit = byte.wrapping_sub(b'0');
        if digit < 10 {
            count += 1;
            if count > 19 {
                return None;
            }
            mantissa = 10 * mantissa + u64::from(digit);
            fraction += i32::from(seen_point);
        } else if byte == b'.' && !seen_point {
            seen_point = true;
        } else {
            break;
        }
        at += 1;
    }
    if count == 0 || mantissa > 1 << 53 {
        return None;
    }
    let exponent = if at == digits.len() { -fraction } else { exponent(&digits[at..])? - fraction };
    let power = POWERS.get(exponent.unsigned_abs() as usize)?;
    let double = if exponent < 0 { mantissa as f64 / power } else { mantissa as f64 * power };
    // An f64 has 29 bits more than an f32 here (no subnormals: 1e-22 is far from them).
    const EXTRA: u64 = (1 << 29) - 1;
    if double.to_bits() & EXTRA == 1 << 28 {
        return None;
    }
    let value = double as f32;
    Some(if negative { -value } else { value })
}

/// `e`, a sign, and up to three digits.
#[inline]
fn exponent(text: &[u8]) -> Option<i32> {
    let [b'e' | b'E', rest @ ..] = text else { return None };
    let (sign, digits) = match rest {
        [b'-', digits @ ..] => (-1, digits),
        [b'+', digits @ ..] => (1, digits),
        _ => (1, rest),
    };
    if digits.is_empty() || digits.len() > 3 {
        return None;
    }
    let mut value = 0;
    for byte in digits {
        if !byte.is_ascii_digit() {
            return None;
        }
        value = 10 * value + i32::from(byte - b'0');
    }
    Some(sign * value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn standard(token: &[u8]) -> Option<u32> {
        std::str::from_utf8(token).ok()?.parse::<f32>().ok().map(f32::to_bits)
    }

    #[test]
    fn hard_cases_are_rounded_as_the_standard_library_does() {
        for token in [
            "0",
            "-0",
            "-0.0",
            ".5",
            "5.",
            "+.5e1",
            "16777217",
            "16777217.0000001",
            "16777219",
            "1.00000005960464477539",
            "1.000000059604644775390625",
            "9007199254740993",
            "9007199254740992",
            "3.4028236e38",
            "1e-45",
            "1e-46",
            "1e999",
            "-1e999",
            "1e22",
            "1e23",
            "123456789012345678901234567890",
            "nan",
            "-nan",
            "inf",
            "Infinity",
            "1.#IND",
            "3.1+e2",
            "",
            "-",
            "+",
            ".",
            "e5",
            "1e",
            "1e+",
            "1.2.3",
            "0x10",
            "1_0",
            "--1",
            "1e1000",
            "0.000000000000000000001",
            "-17.402759552001953",
            "1e-22",
            "8388608.5",
            "8388609.5",
        ] {
            assert_eq!(parse_f32(token.as_bytes()).map(f32::to_bits), standard(token.as_bytes()), "{token}");
        }
    }

    #[test]
    fn fortran_exponents_and_decimal_commas() {
        let read = |token: &str| parse_f32(token.as_bytes());
        for (token, value) in [
            ("1.0D+00", 1.0),
            ("-2.5d-1", -0.25),
            ("1d2", 100.0),
            ("0,5", 0.5),
            ("-1,25E1", -12.5),
            (",5", 0.5),
            ("3,", 3.0),
            ("1,5D3", 1500.0),
        ] {
            assert_eq!(read(token), Some(value), "{token}");
        }
        for token in ["1,000,000", "1.000,5", "1,000.5", "1d2d3", "d", "-d1", "1e2d3", "nand", "1,e,1", ","] {
            assert_eq!(read(token), None, "{token}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        #[test]
        fn printed_floats(bits: u32, digits in 0_usize..20) {
            let value = f32::from_bits(bits);
            for text in [format!("{value}"), format!("{value:e}"), format!("{value:.digits$}"), format!("{:.digits$}", value % 1000.0)] {
                prop_assert_eq!(parse_f32(text.as_bytes()).map(f32::to_bits), standard(text.as_bytes()), "{}", text);
            }
        }

        #[test]
        fn halfway_points(bits in 0x3300_0000_u32..0x5000_0000, nudge in -1_i64..=1) {
            let (low, high) = (f64::from(f32::from_bits(bits)), f64::from(f32::from_bits(bits + 1)));
            let middle = f64::from_bits((f64::midpoint(low, high).to_bits() as i64 + nudge) as u64);
            let text = format!("{middle}");
            prop_assert_eq!(parse_f32(text.as_bytes()).map(f32::to_bits), standard(text.as_bytes()), "{}", text);
        }

        #[test]
        fn decimal_text(text in "[-+]?[0-9]{0,12}[.]?[0-9]{0,12}([eE][-+]?[0-9]{0,3})?") {
            prop_assert_eq!(parse_f32(text.as_bytes()).map(f32::to_bits), standard(text.as_bytes()), "{}", text);
        }
    }
}
