/** Controllers of headsets in scenes of three.js: they grab, turn and scale models, and teleport. */

const FARTHEST = 30; // where a teleport ends, in the world's units

/** The two hands of a visitor. */
export class ThreeHands {
  /**
   * @param {any} three The module `three/webgpu`.
   * @param {any} renderer Its `xr` is enabled.
   * @param {any} rig The group that holds the camera; teleports move it over the plane y = 0.
   * @param {Iterable<{object: any, sphere: any}>} models Which can be grabbed.
   */
  constructor(three, renderer, rig, models) {
    this._three = three;
    this._renderer = renderer;
    this._rig = rig;
    this._models = models;
    /** @type {Map<any, {hands: any[], start: any, inverse: any}>} Of each held model, its place when a hand came or went. */
    this._held = new Map();
    /** Groups of three.js that stand where the controllers are. */
    this.controllers = [0, 1].map((index) => {
      const controller = renderer.xr.getController(index);
      controller.addEventListener("squeezestart", () => this._grab(controller));
      for (const end of ["squeezeend", "disconnected"]) controller.addEventListener(end, () => this._release(controller));
      controller.addEventListener("select", () => this._teleport(controller));
      rig.add(controller);
      return controller;
    });
  }

  /** Move the held models; call it before each picture. */
  update() {
    this._rig.updateWorldMatrix(true, true);
    for (const [{ object }, { hands, start, inverse }] of this._held) {
      const pose = this._pose(hands);
      if (pose.determinant() * inverse.determinant() === 0) continue; // two hands at one place
      const world = pose.multiply(inverse).multiply(start);
      if (object.parent) world.premultiply(object.parent.matrixWorld.clone().invert());
      world.decompose(object.position, object.quaternion, object.scale);
    }
  }

  /** Return the ray that a controller points along. */
  _ray(controller) {
    controller.updateWorldMatrix(true, false);
    const { Raycaster } = this._three;
    return new Raycaster().setFromXRController(controller).ray;
  }

  /** Take the nearest model that a controller is in or points at. */
  _grab(controller) {
    const ray = this._ray(controller);
    let [nearest, distance] = [null, Infinity];
    for (const model of this._models) {
      const { sphere } = model;
      const away = sphere.containsPoint(ray.origin) ? 0 : ray.intersectSphere(sphere, ray.origin.clone())?.distanceTo(ray.origin);
      if (away < distance) [nearest, distance] = [model, away];
    }
    if (nearest) this._hold(nearest, [...(this._held.get(nearest)?.hands ?? []), controller]);
  }

  _release(controller) {
    for (const [model, { hands }] of this._held) {
      if (hands.includes(controller)) this._hold(model, hands.filter((hand) => hand !== controller));
    }
  }

  _hold(model, hands) {
    this._held.delete(model);
    if (!hands.length) return;
    model.object.updateWorldMatrix(true, false);
    const inverse = this._pose(hands).invert();
    this._held.set(model, { hands, start: model.object.matrixWorld.clone(), inverse });
  }

  /** Return where hands are: of two, from the first towards the second, as large as they are apart. */
  _pose(hands) {
    const { Matrix4, Vector3 } = this._three;
    if (hands.length === 1) return hands[0].matrixWorld.clone();
    const [from, to] = hands.map(({ matrixWorld }) => new Vector3().setFromMatrixPosition(matrixWorld));
    const [up, other] = hands.map(({ matrixWorld }) => new Vector3().setFromMatrixColumn(matrixWorld, 1));
    const x = to.clone().sub(from);
    const z = x.clone().cross(up.add(other)).setLength(x.length());
    const y = z.clone().cross(x).setLength(x.length());
    return new Matrix4().makeBasis(x, y, z).setPosition(from.add(to).multiplyScalar(0.5));
  }

  /** Move the rig so that the visitor stands where a controller points at the ground. */
  _teleport(controller) {
    const { Plane, Vector3 } = this._three;
    const ray = this._ray(controller);
    const goal = ray.intersectPlane(new Plane(new Vector3(0, 1, 0)), new Vector3());
    if (!goal || goal.distanceTo(ray.origin) > FARTHEST) return;
    const head = new Vector3();
    const eyes = this._renderer.xr.getCamera().cameras;
    for (const { matrixWorld } of eyes) head.addScaledVector(new Vector3().setFromMatrixPosition(matrixWorld), 1 / eyes.length);
    this._rig.position.x += goal.x - head.x;
    this._rig.position.z += goal.z - head.z;
  }
}
