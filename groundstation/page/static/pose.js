// Where a craft is and how it lies, from whatever its series say.

const POSITIONS = [ // names of x, y and z, the first that are there
  ["stateEstimate.x", "stateEstimate.y", "stateEstimate.z"],
  ["kalman.stateX", "kalman.stateY", "kalman.stateZ"],
  ["px", "py", "pz"], ["x", "y", "z"],
];

/** At a time: {roll, pitch, yaw, motors, position, plus}; null for what is not known. */
export function poseAt(store, time, vehicle) {
  const value = (name) => store.at("telemetry", name, time);
  const motors = [1, 2, 3, 4].map((one) => value(`motors.M${one}`));
  return {
    roll: value("attitude.roll"), pitch: value("attitude.pitch"), yaw: value("attitude.yaw"),
    motors: motors.includes(null) ? null : motors,
    position: position(store, time),
    plus: vehicle.startsWith("crazyflie1"), // it flies as a plus, later ones as an X
  };
}

function position(store, time) {
  for (const names of POSITIONS) {
    for (const [table, { columns }] of store.tables) {
      if (columns.includes(names[2])) return names.map((one) => store.at(table, one, time));
    }
  }
  return [null, null, null];
}
