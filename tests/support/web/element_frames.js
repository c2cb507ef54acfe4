// Draw frames by the generator of an element, and return its rows and pictures as base64.
async ([name, frames]) => {
  const element = document.querySelector(`gsgen-model[name="${name}"]`);
  element.scrollIntoView();
  const pause = () => new Promise((resolve) => setTimeout(resolve, 50));
  while (!element.report) await pause();
  // The element's own frames would run the model for another camera between these.
  element._requestFrame = () => {};
  cancelAnimationFrame(element._frameRequest);
  while (element._isDrawing) await pause();
  clearTimeout(element._rest);
  const { errors } = element.report;
  if (errors.length) return { error: JSON.stringify(errors), errors };
  const { readBuffer } = await import("gsgen/gpu_buffers.js");
  const { model, renderer } = element._shown;
  const uncaptured = [];
  renderer.device.onuncapturederror = ({ error }) => uncaptured.push(error.message);
  const text = async (numbers) => {
    const url = await new Promise((resolve) => {
      const reader = new FileReader();
      reader.onload = () => resolve(reader.result);
      reader.readAsDataURL(new Blob([numbers]));
    });
    return url.slice(url.indexOf(",") + 1);
  };
  const result = { images: [], rows: [], isCaptured: model.isCaptured, errors: uncaptured };
  for (const { camera, values } of frames) {
    if (await model.update(values, camera)) renderer.setScene(model.sets);
    await renderer.drawWhole(camera);
    const { dims, gpuBuffer } = model._outputs[model.manifest.outputs.gaussians.name];
    const numbers = dims[0] * dims[1];
    result.rows.push(await text(await readBuffer(renderer.device, gpuBuffer, Float32Array, numbers)));
    result.images.push(await text(await renderer.readImage("color")));
  }
  result.isLinear = model.buffers.isLinear;
  element.remove();
  return result;
}
