export function addSuspicions() {}
