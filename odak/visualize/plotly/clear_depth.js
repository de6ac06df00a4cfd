// In an image all scenes of a figure share one WebGL context. A scene that ends with something transparent leaves the
// writing of depth switched off, and then the next scene's clearing would leave the old depths in its way.
(() => {
  for (const context of [WebGLRenderingContext, WebGL2RenderingContext]) {
    const clear = context.prototype.clear;
    context.prototype.clear = function (mask) {
      if (mask & this.DEPTH_BUFFER_BIT) this.depthMask(true);
      clear.call(this, mask);
    };
  }
})();
