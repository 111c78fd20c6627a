//! Designs and filters against independent tools, and the algebra beneath them.

mod algebra;
mod allocation;
mod compensation;
mod consistency;
mod delayed;
mod design;
mod handover;
mod place;
mod riccati;
mod stiff;
mod support;
