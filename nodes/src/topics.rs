//! Topics that each role publishes, for the access control of a protected bench.

use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Health, Imu, Message, Odometry, Outputs,
    Progress, Reported, Sent, Setpoint, Truth,
};

use crate::config::Role;
use crate::mirror::PACE_TOPIC;

/// Topics that a role publishes, besides its `Health`.
pub fn published_by(role: Role) -> &'static [&'static str] {
    match role {
        Role::Plant => &[
            Imu::TOPIC,
            Odometry::TOPIC,
            Outputs::TOPIC,
            Truth::TOPIC,
            Disturbance::TOPIC,
            Adjustment::TOPIC,
            Sent::TOPIC,
            Reported::TOPIC,
        ],
        Role::Estimator => &[Estimate::TOPIC],
        Role::Controller => &[Command::TOPIC, Setpoint::TOPIC, Adjustment::TOPIC, Autopilot::TOPIC],
        Role::Recorder => &[Progress::TOPIC],
        Role::Mirror => &[Finding::TOPIC, PACE_TOPIC],
    }
}

/// All topics of the roles, and `health`: no other program may publish on them.
pub fn of_the_loop() -> Vec<&'static str> {
    let roles = Role::ALL.into_iter().flat_map(published_by).copied();
    roles.chain([Health::TOPIC]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_recorded_topic_has_one_writer() {
        macro_rules! recorded {
            ($($name:ident: $message:ident),* $(,)?) => { [$(whirlstand_msgs::$message::TOPIC),*] };
        }
        for topic in whirlstand_logs::loop_topics!(recorded) {
            let writers = Role::ALL.iter().filter(|r| published_by(**r).contains(&topic)).count();
            assert_eq!(writers, 1, "{topic}");
        }
    }
}
