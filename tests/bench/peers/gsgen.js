// The page of the guide. A frame is whole when it is submitted with what shows it on the canvas.
import "/gsgen/gsgen.js";
import { fieldOfView, run } from "./page.js";

async function open(canvas, src, camera, onFrame) {
  const element = /** @type {any} */ (document.createElement("gsgen-model"));
  let [shows, last] = [false, ""];
  const { getCurrentTexture } = GPUCanvasContext.prototype;
  GPUCanvasContext.prototype.getCurrentTexture = function () {
    shows = true;
    return getCurrentTexture.call(this);
  };
  const { submit } = GPUQueue.prototype;
  GPUQueue.prototype.submit = function (commands) {
    submit.call(this, commands);
    if (!shows) return;
    shows = false;
    if (element.state === "loading") last = engine.canvas().toDataURL();
    onFrame();
  };
  element.style.cssText = "display: block; width: 640px; height: 360px";
  element.setAttribute("background", "black");
  element.minRenderScale = 1; // other engines draw all pixels, too
  const { azimuth, elevation, radius, target } = camera.orbit;
  element.cameraOrbit = `${azimuth} ${elevation} ${radius}`;
  element.cameraTarget = target.join(" ");
  element.fieldOfView = fieldOfView(camera);
  element.src = src;
  engine.canvas = () => element.shadowRoot.querySelector("canvas");
  canvas.replaceWith(element);
  await element.ready;
  const look = ({ orbit }) => (element.orbit = orbit);
  return { look, lastPicture: () => last };
}

const engine = { open };
window.bench = run(engine);
