/** The element `<gsgen-model>`: shows a splat file or a generator in a page. */

import { Annotations } from "./annotations.js";
import { show } from "./backend.js";
import { GsgenError } from "./errors.js";
import { ModelControls } from "./model_controls.js";
import { canShow, sourceFile } from "./source_files.js";

/** @typedef {"empty" | "loading" | "ready" | "failed"} State */
/** @typedef {import("./shown_model.js").ShownModel} ShownModel */

const MINUTE = 60_000; // milliseconds
const MOST_LOSSES = 6; // of the device within a minute, after which the element gives up
const REST = 200; // milliseconds after the last frame, until that which stays is drawn
const LOSS_DELAY = 100; // milliseconds from an error of a lost device to the news of its loss
const MOST_FAILED_FRAMES = 3; // one after the other, of a time that plays
const NEW_HOME = ["camera-orbit", "camera-target", "up"];
const NEW_LENS = ["min-camera-orbit", "max-camera-orbit", "field-of-view"];

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

export class GsgenModel extends ModelControls {
  /** Return whether a `<source>` of a MIME type is tried. @param {string} type */
  static canShow(type) {
    return canShow(type);
  }

  constructor() {
    super();
    this._internals = this.attachInternals();
    /** @type {State} */
    this._state = "empty";
    /** What was found out about the model: its errors, or its manifest. @type {any} */
    this.report = null;
    /** @type {import("./present.js").Presenter | null} */
    this._presenter = null;
    /** @type {import("./source_files.js").SourceFile | null} Kept, so that it is not loaded again. */
    this._file = null;
    /** @type {string[]} The addresses that the last load tried. */
    this._tried = [];
    this._isPending = true; // until it is in view
    this._loading = new AbortController();
    this._isBack = false; // after a loss
    this._isPartial = false; // what is shown is still arriving
    /** @type {number[]} Moments at which the device was lost. */
    this._losses = [];
    this._failedFrames = 0;
    this._frameRequest = 0;
    this._drawnAt = -Infinity;
    /** @type {any} */
    this._rest = null; // the timer of the frame that stays
    this._isVisible = false;
    this._isDrawing = false;
    this._isMissed = false;
    /** @type {(Blob | string)[] | null} */
    this._pictures = null;
    this._view.play.addEventListener("click", () => (this.paused ? this.play() : this.pause()));
    this._view.time.addEventListener("input", () => {
      // The slider shows the present time again when the model pauses.
      const share = Number(this._view.time.value) / 1000;
      this.pause();
      this.currentTime = share * this.duration;
    });
    this._view.poster.addEventListener("error", () => this._complain("poster", `"${this.poster}" cannot be shown`));
    this.addEventListener("dragover", (event) => this.fileDrop && event.preventDefault());
    this.addEventListener("drop", (event) => this._drop(event));
    this._resizes = new ResizeObserver(() => this._requestFrame());
    this._visibility = new IntersectionObserver((entries) => this._see(entries[entries.length - 1].isIntersecting));
    this._annotations = new Annotations(this, this._view.annotations, {
      onChange: () => this._childrenChanged(),
      complain: (where, problem) => this._complain(where, problem),
    });
  }

  connectedCallback() {
    super.connectedCallback();
    this._describe();
    this._view.showPoster(this._shown ? null : this.poster);
    this._resizes.observe(this);
    this._visibility.observe(this);
    this._annotations.observe();
    if (!this._shown) this._isPending = true;
    if (this.loading === "eager") this._loadIfPending();
    this._requestFrame();
  }

  disconnectedCallback() {
    // An element that moves is connected again at once, and keeps its model.
    queueMicrotask(() => {
      if (this.isConnected) return;
      this._resizes.disconnect();
      this._visibility.disconnect();
      this._annotations.disconnect();
      this._stopLoading();
      this._release();
      this._enter("empty");
    });
  }

  /** A document takes no style from another one. */
  adoptedCallback() {
    this._view.adopt();
  }

  attributeChangedCallback(name, before, now) {
    super.attributeChangedCallback(name, before, now);
    if (!this.isConnected || before === now) return;
    const { _playback: playback, _shown: shown } = this;
    if (["src", "images", "image-cameras"].includes(name)) this._sourceChanged();
    else if (name === "posts") this._usePosts();
    else if (name === "alt" || name === "camera-controls") this._describe();
    else if (name === "poster" && !shown) this._view.showPoster(this.poster);
    else if (name === "loading" && this.loading === "eager") this._loadIfPending();
    else if (shown && NEW_HOME.includes(name)) shown.orbit = this._firstOrbit(shown.model);
    else if (shown && NEW_LENS.includes(name)) shown.orbit = this._firstOrbit(shown.model).following(shown.orbit);
    else if (playback && name === "loop") playback.loop = this._loops(playback);
    else if (playback && name === "time" && this.time !== null) {
      playback.value = this.time;
      this._timeChanged();
    }
    this._requestFrame();
  }

  // ----- State

  /** `empty`, `loading`, `ready` or `failed`; for CSS, too: `:state(failed)`. */
  get state() {
    return this._state;
  }

  /** Whether nothing remains to be loaded. */
  get complete() {
    return !this._candidates().length || this._state === "ready" || this._state === "failed";
  }

  /** The address that is shown: that of `src`, or of a `<source>`. */
  get currentSrc() {
    return this._file?.address ?? "";
  }

  /** Of tilesets, how many tiles and bytes have come; null of other models. */
  get statistics() {
    return this._shown?.model.statistics ?? null;
  }

  /** @param {State} state */
  _enter(state) {
    if (state === this._state) return;
    this._state = state;
    this._internals.states.clear();
    this._internals.states.add(state);
    this._tell("statechange", { state });
  }

  /** Tell an error, and show it in place of the model. */
  _fail(error) {
    const { rule = "", where = "", hint = "", message, findings = [] } = error;
    this._view.hideProgress();
    this._view.showError(error);
    this.report = { manifest: null, errors: [{ rule, where, message, hint }], findings };
    this._enter("failed");
    this._tell("error", { rule, where, message, hint });
    this._settleReady(error);
    if (!(error instanceof GsgenError)) reportError(error);
  }

  // ----- Loading

  _see(isVisible) {
    this._isVisible = isVisible;
    this._shown?.see(isVisible);
    if (isVisible) this._loadIfPending();
    this._requestFrame();
  }

  /** Show a file that was dropped on an element with the attribute `file-drop`. */
  _drop(event) {
    const dropped = [...(event.dataTransfer?.files ?? [])];
    const [file] = dropped;
    if (!file || !this.fileDrop) return;
    event.preventDefault();
    if (dropped.every(({ type }) => type.startsWith("image/"))) {
      this.pictures = dropped;
      return;
    }
    this.name = file.name;
    const before = this.src;
    this.src = URL.createObjectURL(file);
    if (before.startsWith("blob:")) URL.revokeObjectURL(before);
  }

  /**
   * The pictures that a generator computes its Gaussians from: files, or those of `images`.
   * @returns {(Blob | string)[]}
   */
  get pictures() {
    return this._pictures ?? this._valueOf("images").map((source) => new URL(source, document.baseURI).href);
  }

  /** @param {(Blob | string)[] | null} sources Files or addresses; null for those of `images`. */
  set pictures(sources) {
    this._pictures = sources && [...sources];
    if (this.isConnected) this._sourceChanged();
  }

  _childrenChanged() {
    const sources = this._candidates().map(({ source }) => source);
    const isLonger = this._state === "failed" && sources.length > this._tried.length;
    if (sources[0] !== this._tried[0] || isLonger) this._sourceChanged();
    if (this._shown?.camera) this._annotations.place(this._shown.camera);
  }

  _sourceChanged() {
    this._isPending = true;
    this._stopLoading();
    this._kept = null;
    if (this._ready.isSettled) this._renewReady();
    if (this._candidates().length) {
      if (this._isVisible || this._shown || this.loading === "eager") this._loadIfPending();
      return;
    }
    this._release();
    [this._file, this._kept, this._tried] = [null, null, []];
    this._view.showError(null);
    this._view.hideProgress();
    this._view.showPoster(this.poster);
    this._enter("empty");
  }

  _loadIfPending() {
    if (this._isPending && this.isConnected) this._load();
  }

  /** Stop loading; what has arrived of a model that is drawn meanwhile goes, too. */
  _stopLoading() {
    this._loading.abort();
    if (this._isPartial) this._release();
  }

  /** Release the model, but for its camera and time: it may come back. */
  _release() {
    cancelAnimationFrame(this._frameRequest);
    clearTimeout(this._rest);
    this._frameRequest = 0;
    if (this._shown) {
      const { file, orbit, playback, camera } = this._shown;
      this._kept = { file, orbit, playback, camera };
      this._shown.destroy();
    }
    this._presenter?.destroy();
    this._shown = this._presenter = null;
    this._isPartial = false;
  }

  async _load() {
    const candidates = this._candidates();
    this._stopLoading();
    const { signal } = (this._loading = new AbortController());
    this._tried = candidates.map(({ source }) => source);
    this._isPending = !candidates.length;
    if (!candidates.length) {
      const types = [...this.querySelectorAll(":scope > source")].map((element) => element.getAttribute("type"));
      if (types.length) this._complain("source", `has no type that is shown: ${types.join(", ")}`);
      return;
    }
    if (this._ready.isSettled) this._renewReady();
    this._view.showError(null);
    this._enter("loading");
    for (const { source, element } of candidates) {
      try {
        return await this._open(source, signal);
      } catch (error) {
        await pause(LOSS_DELAY); // a loss of the device loads again
        if (signal.aborted) return;
        if (this._isPartial) this._release();
        element?.dispatchEvent(new Event("error"));
        if (source !== candidates[candidates.length - 1].source) continue;
        this._release();
        this._fail(error);
      }
    }
  }

  async _open(source, signal) {
    const file = sourceFile(source);
    this._file = file;
    const name = this.getAttribute("name") ?? source;
    let isPrepared = false;
    const options = {
      source,
      onProgress: (loaded, total) => {
        this._view.showProgress(loaded, total);
        this._tell("progress", { loaded, total });
      },
      onBegin: (shown) => {
        isPrepared = true;
        this._begin(shown);
      },
      onLost: (loss) => signal.aborted || this._lose(loss),
      target: this.target,
      pictures: this.pictures,
      imageCameras: this.imageCameras,
      maxError: this.maxError ?? undefined,
      maxSplats: this.maxSplats ?? undefined,
      onChange: () => this._requestFrame(),
      signal,
      onWarning: (where, problem) => this._complain(where, problem),
      onError: ({ message, hint }) => this._tell("error", { rule: "", where: name, message, hint }),
    };
    const shown = await show(file, name, options);
    if (signal.aborted) return shown.destroy();
    if (!isPrepared) this._prepare(shown);
    const [width, height] = this._size();
    cancelAnimationFrame(this._frameRequest);
    [this._frameRequest, this._isMissed] = [0, false];
    // The last picture stays until this one is drawn. A frame of rows that arrive may have shown all.
    const isDrawn = shown === this._shown && (await shown.showsAll(width, height, this._look()));
    const failure = width && height && !isDrawn ? await shown.draw(width, height, this._look(shown)).then(() => null, (error) => error) : null;
    if (failure) await pause(LOSS_DELAY);
    if (signal.aborted) return shown.destroy();
    if (shown !== this._shown) this._shown?.destroy();
    [this._shown, this._kept, this._failedFrames, this._isPartial] = [shown, null, 0, false];
    shown.see(this._isVisible);
    this._annotations.write(shown.model.annotations ?? [], (camera) => (this.orbit = camera));
    this._view.hideProgress();
    this._view.showPoster(null);
    this._view.say(`Loaded${shown.renderedBy === "webgpu" ? "" : " without WebGPU"}: ${this.getAttribute("alt") ?? name}`);
    this._timeChanged();
    this._checkInputs();
    if (failure) return this._fail(failure);
    this._present(this._look());
    this._succeed();
    if (this._isMissed || this.autoRotate || shown.playback?.paused === false) this._requestFrame();
    this._usePosts();
    shown.useSound(this._view.root, signal).catch(({ message }) => signal.aborted || this._complain("sound", message));
  }

  /** The post-process models that the picture goes through: those of a scene, and of `posts`. */
  async _usePosts() {
    const { _shown: shown } = this;
    const own = this._valueOf("posts").map((address) => ({ address, where: address, inputs: {} }));
    const isOther = await shown?.usePosts([...(shown.model.posts ?? []), ...own], this.target, ({ message, hint }) => {
      this._complain("posts", [message, hint].filter(Boolean).join(" "));
    });
    if (!isOther) return;
    this._checkInputs();
    this._requestFrame();
  }

  /** Draw what begins to arrive, where nothing else is shown; its kernels are compiled meanwhile. */
  _begin(shown) {
    this._prepare(shown);
    const [width, height] = this._size();
    if (width && height) shown.compile(width, height, this._look(shown)).catch(() => {}); // frames tell it, too
    if (this._shown || this.poster) return;
    [this._shown, this._isPartial] = [shown, true];
    this._requestFrame();
  }

  /** Give a model its camera and its time: its own of before, or those of the attributes. */
  _prepare(shown) {
    const kept = this._kept?.file === shown.file ? this._kept : null;
    if (kept) {
      [shown.orbit, shown.playback] = [kept.orbit, kept.playback];
      return;
    }
    shown.orbit = this._firstOrbit(shown.model);
    const { orbit } = this._wish;
    if (shown.playback) this._startTime(shown.playback);
    shown.followTime();
    if (orbit) shown.orbit.move(orbit);
    this._wish = {};
  }

  /** Tell that the model is shown, at first or again. */
  _succeed() {
    const { model, renderedBy } = /** @type {ShownModel} */ (this._shown);
    const isRecovery = this._isBack || this._state === "failed";
    this._isBack = false;
    this._view.showError(null);
    this.report = { manifest: model.manifest ?? null, errors: [], findings: model.findings ?? [], renderedBy };
    this._enter("ready");
    this._tell(isRecovery ? "recover" : "load", { count: model.buffers.count });
    this._settleReady();
  }

  /** Open everything again if the device goes away, as browsers allow after a driver's fault. */
  _lose({ message, reason }) {
    const now = performance.now();
    this._losses = [...this._losses.filter((moment) => now - moment < MINUTE), now];
    this._release();
    this._isBack = true;
    if (this._losses.length <= MOST_LOSSES) this._load();
    else {
      this._loading.abort();
      this._fail(new GsgenError(`the graphics device was lost: ${message || reason}`));
    }
  }

  // ----- Frames

  _requestFrame() {
    if (!this._shown) this._isMissed = true; // by a model that is on its way
    if (this._frameRequest || !this._shown || !this._isVisible) return;
    clearTimeout(this._rest);
    this._frameRequest = requestAnimationFrame((now) => {
      this._frameRequest = 0;
      this._draw(now);
    });
  }

  /** @param {boolean} [isFinal] Whether the frame is drawn as it stays. */
  async _draw(now, isFinal = false) {
    const { _shown: shown } = this;
    const [width, height] = this._size();
    if (!shown || !this._isVisible || !width || !height) return;
    if (this._isDrawing) {
      this._isMissed = true;
      return;
    }
    this._isDrawing = true;
    try {
      if (shown.playback?.advance(now)) this._timeChanged();
      this._rotate(now);
      const look = this._look();
      // A frame that comes soon after another one is one of a movement.
      const isMoving = performance.now() - this._drawnAt < REST;
      if (isFinal) await shown.drawFinal(width, height, look);
      else await shown.draw(width, height, look, isMoving ? this.minRenderScale : 1);
      if (this._shown === shown) this._present(look);
      // Rows may arrive faster than they are drawn: frames of some of them do not queue up.
      if (this._isPartial) await shown.kernels.device.queue.onSubmittedWorkDone();
    } catch (error) {
      await this._failFrame(error, shown);
    } finally {
      this._isDrawing = false;
      this._drawnAt = performance.now();
    }
    const plays = shown.playback && !shown.playback.paused && this._failedFrames < MOST_FAILED_FRAMES;
    if (this._isMissed || plays) this._requestFrame();
    else if (!this._frameRequest && !shown.isFinal(this._look())) {
      this._rest = setTimeout(() => this._draw(performance.now(), true), REST);
    }
    this._isMissed = false;
  }

  /** Show the last frame on the canvas. @param {import("./shown_model.js").Look} look */
  _present(look) {
    const { _shown: shown, _view: { canvas } } = this;
    if (!shown?.camera) return;
    const { camera } = shown;
    if (canvas.width !== camera.width) canvas.width = camera.width;
    if (canvas.height !== camera.height) canvas.height = camera.height;
    if (this._presenter?.device !== shown.kernels.device) {
      this._presenter?.destroy();
      this._presenter = shown.presenterOf(canvas);
    }
    shown.show(this._presenter, look);
    this._annotations.place(camera);
    if (this._failedFrames || this._state === "failed") this._succeed();
    this._failedFrames = 0;
  }

  /** Tell the error of a frame once; the next frame that is drawn takes it back. */
  async _failFrame(error, shown) {
    await pause(LOSS_DELAY);
    if (this._shown !== shown) return; // removed, replaced or lost meanwhile
    this._failedFrames += 1;
    const isKnown = this._state === "failed" && this.report?.errors[0]?.message === error.message;
    if (!isKnown) this._fail(error);
  }
}
