//! Analysis of the residual that the causes leave: lack of fit, turbulence, narrow-band noise, forces outside
//! the library.

pub mod axis;
pub mod basis;
pub mod comparison;
pub mod credibility;
pub mod device_basis;
pub mod excess_noise;
pub mod hysteresis_relay;
pub mod lack_of_fit;
pub mod narrow_band;
pub mod out_of_library;
pub mod random_force;
pub mod turbulence;
pub mod with_turbulence;
