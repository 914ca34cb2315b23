//! Which vector instructions run, decided at run time.
//!
//! Vector code here is plain Rust that the compiler vectorises, compiled once per level inside a function
//! with the level's target features. No level fuses multiplications and additions, so all levels give the
//! same bits; tests hold them to that.

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SimdLevel {
    /// What the target always has (SSE2 on x86-64).
    Portable,
    /// AVX2, on x86-64.
    Avx2,
    /// AVX-512 F, BW, DQ and VL, on x86-64.
    Avx512,
}

impl SimdLevel {
    /// The best level of this processor.
    pub fn detect() -> Self {
        static BEST: std::sync::OnceLock<SimdLevel> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| *Self::available().last().unwrap_or(&SimdLevel::Portable))
    }

    /// The wanted level, or the best below it that this processor has; the best of all where none is wanted.
    /// Whatever a caller asks for, no instruction runs that the processor lacks.
    pub fn choose(wanted: Option<Self>) -> Self {
        wanted.map_or_else(Self::detect, |level| level.min(Self::detect()))
    }

    /// Every level this processor has, in rising order.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut, reason = "only x86-64 has more than one level")]
        let mut levels = vec![SimdLevel::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
                levels.push(SimdLevel::Avx2);
                if is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
                {
                    levels.push(SimdLevel::Avx512);
                }
            }
        }
        levels
    }
}

/// Defines `fn $name($level, args...)` that runs the inlined `$body(args...)` compiled for that [`SimdLevel`](crate::SimdLevel).
#[macro_export]
macro_rules! vectorised {
    ($(#[$doc:meta])* $vis:vis fn $name:ident $(<$($g:ident : $b:path),*>)? ($($arg:ident : $t:ty),* $(,)?) $(-> $r:ty)? = $body:path) => {
        $(#[$doc])*
        #[allow(clippy::too_many_arguments, reason = "a kernel takes its arrays one by one")]
        $vis fn $name $(<$($g: $b),*>)? (level: $crate::SimdLevel, $($arg: $t),*) $(-> $r)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,popcnt")]
                #[allow(clippy::too_many_arguments, reason = "as above")]
                fn avx2 $(<$($g: $b),*>)? ($($arg: $t),*) $(-> $r)? { $body($($arg),*) }
                #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
                #[allow(clippy::too_many_arguments, reason = "as above")]
                fn avx512 $(<$($g: $b),*>)? ($($arg: $t),*) $(-> $r)? { $body($($arg),*) }
                match level {
                    $crate::SimdLevel::Portable => {}
                    // SAFETY: levels come from `detect`, `available` or `choose`, which name only what the processor has.
                    $crate::SimdLevel::Avx2 => return unsafe { avx2 $(::<$($g),*>)? ($($arg),*) },
                    // SAFETY: as above.
                    $crate::SimdLevel::Avx512 => return unsafe { avx512 $(::<$($g),*>)? ($($arg),*) },
                }
            }
            let _ = level;
            $body($($arg),*)
        }
    };
}
