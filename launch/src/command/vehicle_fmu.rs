//! `whirlstand vehicle fmu`: a vehicle as a functional mock-up unit.

use std::io::Cursor;
use std::path::Path;

use whirlstand_fmu::{Settings, find_library, write_archive};
use whirlstand_msgs::units::clean;
use whirlstand_vehicle::Vehicle;

use crate::cli::VehicleFmuArgs;
use crate::error::Failure;

/// Runs the command.
pub(crate) fn vehicle_fmu(vehicle: &Vehicle, args: &VehicleFmuArgs) -> Result<(), Failure> {
    if !(args.rate > 0.0 && args.rate.is_finite()) {
        return Err(Failure::Mend(format!("--rate {}: a rate above 0 Hz is expected", args.rate)));
    }
    let executable = std::env::current_exe()
        .map_err(|e| Failure::Run(format!("the path of this executable is unknown: {e}")))?;
    let library = find_library(&executable).map_err(Failure::mend)?;
    let settings = Settings { period_s: 1.0 / args.rate, seed: args.seed };
    let mut archive = Cursor::new(Vec::new());
    write_archive(vehicle, settings, &library, &mut archive).map_err(Failure::mend)?;
    if let Some(folder) = args.out.parent().filter(|f| *f != Path::new("")) {
        std::fs::create_dir_all(folder).map_err(|e| Failure::file("make the folder", folder, &e))?;
    }
    std::fs::write(&args.out, archive.into_inner()).map_err(|e| Failure::file("write", &args.out, &e))?;
    crate::style::say(&format!(
        "{}: FMI 3.0 FMU with steps of {} s written to {}",
        vehicle.name,
        clean(settings.period_s),
        args.out.display()
    ));
    Ok(())
}
