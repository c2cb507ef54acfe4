import * as pc from "playcanvas";
import { fieldOfView, placeOf, run } from "./page.js";

async function open(canvas, src, camera, onFrame) {
  const device = await pc.createGraphicsDevice(canvas, { deviceTypes: ["webgl2"], antialias: false });
  device.maxPixelRatio = 1;
  const options = new pc.AppOptions();
  options.graphicsDevice = device;
  options.componentSystems = [pc.CameraComponentSystem, pc.GSplatComponentSystem];
  options.resourceHandlers = [pc.GSplatHandler, pc.TextureHandler]; // the images of SOG files are textures
  const app = new pc.AppBase(canvas);
  app.init(options);
  app.setCanvasFillMode(pc.FILLMODE_NONE, canvas.width, canvas.height);
  app.start();
  const own = new pc.Entity();
  own.addComponent("camera", { clearColor: new pc.Color(0, 0, 0), nearClip: 0.01, farClip: 1000 });
  app.root.addChild(own);
  const look = (next) => {
    const { eye, target, up } = placeOf(next);
    own.camera.fov = fieldOfView(next);
    own.setPosition(...eye);
    own.lookAt(new pc.Vec3(target), new pc.Vec3(up));
  };
  look(camera);
  let isReady = false;
  app.systems.gsplat.on("frame:ready", (_camera, _layer, ready, loading) => (isReady = ready && !loading));
  const asset = new pc.Asset("splats", "gsplat", { url: src });
  app.assets.add(asset);
  const loaded = new Promise((resolve, reject) => {
    asset.once("load", resolve);
    asset.once("error", reject);
  });
  app.assets.load(asset);
  await loaded;
  const splats = new pc.Entity();
  splats.addComponent("gsplat", { asset });
  app.root.addChild(splats);
  app.on("frameend", onFrame);
  return { look, isSorted: () => isReady };
}

window.bench = run({ open });
