// Pages that are opened as files may not start a worker: their search runs in a hidden frame.
if (location.protocol === "file:") {
  const load = (scope, url) => new Promise((resolve, reject) => {
    const script = scope.document.createElement("script");
    Object.assign(script, { src: url, onload: resolve, onerror: reject });
    scope.document.body.append(script);
  });

  window.Worker = class FrameWorker extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      const scope = this.scope = frame.contentWindow;
      scope.document.open();
      scope.document.write("<body></body>");
      scope.document.close();
      scope.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      scope.importScripts = (...urls) =>
        urls.reduce((before, one) => before.then(() => load(scope, one)), Promise.resolve());
      this.ready = load(scope, url);
    }

    postMessage(data) {
      this.ready.then(() => this.scope.dispatchEvent(new MessageEvent("message", { data })));
    }
  };
}
