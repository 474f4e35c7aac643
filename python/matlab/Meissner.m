classdef Meissner < handle
  % Meissner  Client of meissner, the driver of a tactile display, for MATLAB and Octave.
  %
  %   m = Meissner('http://lab-pc:8765', 'token', 'mst_...');   % Psychtoolbox: also 'clock', @GetSecs
  %   m.arm('assume_rest', true);                     % you state that all pins are at rest
  %   play = m.play('edge-45', 'seconds', 0.3, 'at', m.now() + 0.5, 'scale', 0.8);
  %   receipt = m.wait(play);                         % an error if the play was stopped
  %   receipt.onset.time                              % on your clock, within +-receipt.onset.uncertainty s
  %   m.close();                                      % disarms, if this client has armed
  %
  % Methods as in the Python package: status, synchronise, now, arm, disarm, stop, estop, reset, play, later, wait, receipt,
  % session, answer, session_end, close. What are methods of a play or a session there take it first here, as in m.wait(play). Times
  % are in seconds of the clock that 'clock' reads: GetSecs of Psychtoolbox, or by default the time since this object was made. What
  % needs no times, such as storing a pattern, the command line does.
  %
  % The daemon must listen on TCP: see docs/lab-pc.md. MATLAB sends commands by webwrite. Octave's webwrite sends forms
  % only, and its webread one header, so Octave needs the program curl. An error has the identifier meissner:CODE with the API's
  % code; MATLAB's webwrite and webread hide the code: then it is meissner:http.
  %
  % Invariant: a command is sent once; a time errs by at most its uncertainty, while the clocks differ in rate by less than 200 ppm.

  properties (SetAccess = private)
    url        % of the daemon
    array      % that it drives: name, positions_mm, tick_hz and so on, as in GET /v1/array
  end

  properties (Access = private)
    token = ''
    client                 % this object's name in every request: the daemon knows by it who is silent
    session_id = ''        % of the session that this client owns: every order names it, so that none counts for another one
    session_token = ''
    clock
    samples = zeros(0, 3)  % the daemon's clock, and the bounds of this clock minus the daemon's, s
    has_armed = false
  end

  properties (Constant, Access = private)
    MAX_SKEW = 200e-6      % largest difference in rate between two PCs' clocks
    MAX_SAMPLES = 64
    LONGEST_WAIT = 20      % of one question, s
  end

  methods
    function self = Meissner(url, varargin)
      asked = Meissner.options({'token', 'clock'}, varargin);
      self.url = regexprep(url, '/$', '');
      if isfield(asked, 'token'), self.token = asked.token; end
      begun = tic();
      self.clock = @() toc(begun);
      % Without `rand`: an experiment may have seeded it.
      [~, name] = fileparts(tempname());
      self.client = regexprep(sprintf('%s-%lu', name, begun), '[^A-Za-z0-9_-]', '-');
      self.client = self.client(max(1, end - 63):end);
      if isfield(asked, 'clock'), self.clock = asked.clock; end
      self.synchronise();
      self.array = self.get('/v1/array', 10);
    end

    function delete(self)
      self.close();
    end

    function close(self)
      % Take back what this client has armed: motors that another one has armed, too, stay armed for that one.
      if self.has_armed
        self.has_armed = false;
        try
          self.post('/v1/disarm', struct('own', true), 10);
        catch failure
          % A device that is off already is fine.
          state = self.status();
          if ~any(strcmp(state.state, {'disarmed', 'faulted', 'no-device'})), rethrow(failure); end
        end
      end
    end

    function seconds = now(self)
      % The clock of 'at' and of onset.time, s.
      seconds = self.clock();
    end

    function state = status(self)
      % Ask how daemon and device stand. Each answer improves the comparison of the clocks.
      sent = self.now();
      state = self.get('/v1/status', 10);
      received = self.now();
      if ~isstruct(state) || ~isfield(state, 'state')
        error('meissner:unexpected', '%s does not answer as a meissner daemon: check the address', self.url);
      end
      if ~isempty(state.clock)
        self.compare(sent, received, state.clock.monotonic_ns / 1e9);
      end
    end

    function uncertainty = synchronise(self)
      % Compare the clocks anew. Returns the uncertainty between them, s; Inf without a device.
      for attempt = 1:8
        self.status();
      end
      uncertainty = Inf;
      if ~isempty(self.samples)
        [~, uncertainty] = self.offset_at(self.samples(end, 1));
      end
    end

    function state = arm(self, varargin)
      % Enable the motors. 'assume_rest', true: you have seen that all pins are at rest; 'checked', NAME: who has looked.
      % 'silence', S: the daemon disarms when it hears nothing of this client for S seconds, by default its armed_silence_s. Nothing
      % runs between your calls: call status in breaks. 'stay_armed', true: silence does not disarm.
      body = Meissner.options({'assume_rest', 'checked', 'silence', 'stay_armed'}, varargin);
      if isfield(body, 'silence')
        body.silence_s = body.silence;
        body = rmfield(body, 'silence');
      end
      if isfield(body, 'stay_armed')
        if body.stay_armed, body.unattended = true; end
        body = rmfield(body, 'stay_armed');
      end
      before = self.has_armed;
      self.has_armed = true;  % first: if the answer is lost, the motors may be on
      try
        state = self.post('/v1/arm', body, 10);
      catch failure
        % What the daemon refused has changed nothing; else the motors may be on.
        is_refused = ~any(strcmp(failure.identifier, {'meissner:http', 'meissner:timeout'}));
        self.has_armed = before || ~is_refused;
        rethrow(failure);
      end
    end

    function state = disarm(self)
      % Return the pins and switch the motors off.
      state = self.post('/v1/disarm', struct(), 10);
      self.has_armed = false;
    end

    function state = stop(self)
      % End the running play and clear the queue.
      state = self.post('/v1/stop', struct(), 10);
    end

    function state = estop(self)
      % Turn all lines off at once.
      state = self.post('/v1/estop', struct(), 10);
    end

    function state = reset(self, varargin)
      % Leave an emergency stop or a fault. 'force', true: although another terminal has ordered the emergency stop.
      state = self.post('/v1/reset', Meissner.options({'force'}, varargin), 10);
    end

    function play = play(self, pattern, varargin)
      % Queue a play. Options: seconds, at, scale, trigger (a code, or false), trial, labels (a struct), late, fit, replace,
      % endless, open_loop, strict, hold (s), on_edge (s after an edge of the trigger input), stop_on_edge. 'pattern' is a name, or a struct with the keys of a pattern file; tables of it are cells of
      % structs: struct('wave', {{struct('motor', 9, 'rate_hz', 1000, 'um', samples)}}). 'at' is a time of
      % now(), or an instant such as m.later(receipt.onset, 1.5), which is exact to the tick.
      names = {'seconds', 'at', 'scale', 'trigger', 'trial', 'labels', 'late', 'fit', 'replace', 'endless', 'open_loop', 'strict', 'hold', 'on_edge', 'stop_on_edge'};
      body = Meissner.options(names, varargin);
      body.pattern = pattern;
      name = pattern;
      if isstruct(pattern), name = 'inline'; end
      if isstruct(pattern) && isfield(pattern, 'name'), name = pattern.name; end
      play = self.order(body, name);
    end

    function instant = later(self, instant, seconds)
      % The instant some seconds later, at a whole tick. As 'at' of a play it makes the distance exact to the tick.
      ticks = round(seconds * instant.tick_hz);
      instant.tick = instant.tick + ticks;
      instant.time = instant.time + ticks / instant.tick_hz;
      instant.uncertainty = instant.uncertainty + abs(ticks) / instant.tick_hz * self.MAX_SKEW;
    end

    function receipt = wait(self, play, timeout)
      % Wait until a play has ended, and return its receipt; an error if it was stopped, or not over after timeout s.
      if nargin < 3, timeout = Inf; end
      begun = tic();
      while true
        left = max(0, min(self.LONGEST_WAIT, timeout - toc(begun)));
        raw = self.get(sprintf('/v1/plays/%d?wait=%.3f', play.id, left), left + 10);
        if ~any(strcmp(raw.state, {'queued', 'running'})), break, end
        if toc(begun) >= timeout
          error('meissner:timeout', 'play %d is %s after %g s: wait longer, or call stop', play.id, raw.state, timeout);
        end
      end
      self.status();  % a fresh comparison of the clocks for the times
      receipt = self.receipt_of(raw);
      if ~strcmp(raw.state, 'done')
        error('meissner:play_stopped', 'play %d (%s) was %s: %s; do not count the trial', play.id, raw.name, raw.state, raw.cause);
      end
    end

    function answer(self, play, response, varargin)
      % Record what the participant answered to a play of the running session. Options: correct, rt_ms, level, factors (a struct).
      body = Meissner.options({'correct', 'rt_ms', 'level', 'factors'}, varargin);
      if ~ischar(response), response = num2str(response, 15); end
      body.response = response;
      if isfield(body, 'correct'), body.correct = logical(body.correct); end
      self.post(sprintf('/v1/plays/%d/answer', play.id), Meissner.with_texts(body, 'factors'), 10);
    end

    function receipt = receipt(self, id)
      % What became of a play; without its id, of the last one.
      name = 'last';
      if nargin > 1, name = sprintf('%d', id); end
      receipt = self.receipt_of(self.get(['/v1/plays/' name], 10));
    end

    function id = session(self, varargin)
      % Start a session. Options: participant, exclusive, experiment, seed, labels, record. Every play of this client belongs to it from now on;
      % when it is over without you, plays fail (meissner:session_over) until session_end, or another session. Nothing shows that its
      % owner is there while you call nothing: in a rest break longer than the daemon's session_silence_s call status now and then.
      body = Meissner.options({'participant', 'exclusive', 'experiment', 'seed', 'labels', 'record'}, varargin);
      started = self.post('/v1/sessions', Meissner.with_texts(body), 10);
      self.session_token = started.token;
      self.session_id = started.id;
      id = started.id;
    end

    function session_end(self)
      % End the session after its plays have ended. One that is over already is left.
      if self.session_runs()
        self.wait_until_idle();
        if self.session_runs(), self.post(['/v1/sessions/' self.session_id '/end'], struct(), 10); end
      end
      self.session_token = '';
      self.session_id = '';
    end
  end

  methods (Access = private)
    function wait_until_idle(self)
      % Waits until no play runs or waits.
      while true
        state = self.status();
        if isempty(state.play) && isempty(state.queued) && ~strcmp(state.state, 'returning'), break, end
        pause(0.02);
      end
    end

    function compare(self, sent, received, host)
      % Takes one answer: the daemon read its clock between the two readings of ours.
      sample = [host, sent - host, received - host];
      if ~isempty(self.samples)
        [low, high] = self.bounds(host);
        if sample(2) > high || sample(3) < low
          self.samples = zeros(0, 3);  % a clock was set, or a PC slept
        end
      end
      first = max(1, size(self.samples, 1) - self.MAX_SAMPLES + 2);
      self.samples = [self.samples(first:end, :); sample];
    end

    function [low, high] = bounds(self, host)
      widened = abs(host - self.samples(:, 1)) * self.MAX_SKEW;
      low = max(self.samples(:, 2) - widened);
      high = min(self.samples(:, 3) + widened);
    end

    function [offset, uncertainty] = offset_at(self, host)
      % Our clock minus the daemon's at an instant of the daemon's clock.
      if isempty(self.samples)
        error('meissner:not_known_yet', 'no device was connected when the clocks were compared: connect one, then call status');
      end
      [low, high] = self.bounds(host);
      offset = (low + high) / 2;
      uncertainty = (high - low) / 2;
    end

    function runs = session_runs(self)
      state = self.status();
      runs = ~isempty(self.session_id) && isstruct(state.session) && strcmp(state.session.id, self.session_id);
    end

    function play = order(self, body, name)
      body = Meissner.with_texts(body);
      if ~isempty(self.session_id), body.session = self.session_id; end
      numbers = '';
      if isfield(body, 'at')
        % Written by hand: jsonencode rounds numbers of more than 15 digits.
        if isstruct(body.at)
          numbers = sprintf('"at_tick":%.0f,"boot":%.0f', body.at.tick, body.at.boot);
        else
          host = body.at;
          for attempt = 1:2
            host = body.at - self.offset_at(host);
          end
          numbers = sprintf('"at_monotonic_ns":%.0f', host * 1e9);
        end
        body = rmfield(body, 'at');
      end
      if isfield(body, 'trigger') && isnumeric(body.trigger), body.trigger = struct('code', body.trigger); end
      if isfield(body, 'hold')
        body.hold_ms = 1000 * body.hold;
        body = rmfield(body, 'hold');
      end
      if isfield(body, 'on_edge')
        body.on_edge_ms = 1000 * body.on_edge;
        body = rmfield(body, 'on_edge');
      end
      text = jsonencode(body);
      if ~isempty(numbers), text = [text(1:end - 1) ',' numbers '}']; end
      try
        answer = jsondecode(self.send('POST', '/v1/play', text, 20));
      catch failure
        % MATLAB hides the daemon's answer, so the status has to tell.
        is_refusal = any(strcmp(failure.identifier, {'meissner:http', 'meissner:session_running', 'meissner:session_exclusive'}));
        if ~isempty(self.session_id) && is_refusal && ~self.session_runs()
          error('meissner:session_over', 'session %s is over: call session_end, or start another one (%s)', self.session_id, failure.message);
        end
        rethrow(failure);
      end
      play = struct('id', answer.id, 'pattern', name, 'ordered_s', answer.ordered_ms / 1000);
    end

    function receipt = receipt_of(self, raw)
      late = raw.counts.lateness;
      receipt = struct('id', raw.id, 'pattern', raw.name, 'state', raw.state, 'cause', raw.cause, 'onset', [], 'offset', [], ...
        'late', late.host + late.link + late.device, 'raw', raw);
      receipt.onset = self.instant(raw.onset, raw.device, 'actual_tick');
      receipt.offset = self.instant(raw.offset, raw.device, 'tick');
    end

    function made = instant(self, record, device, tick)
      % A moment of a play: the device's tick, and the time on our clock.
      made = [];
      if isempty(record), return, end
      host = record.monotonic_ns / 1e9;
      [offset, uncertainty] = self.offset_at(host);
      made = struct('tick', record.(tick), 'boot', device.boot, 'tick_hz', device.tick_hz, 'time', host + offset, ...
        'uncertainty', uncertainty + record.uncertainty_ns / 1e9, 'host', host);
    end

    function answer = get(self, path, timeout)
      answer = jsondecode(self.send('GET', path, '', timeout));
    end

    function answer = post(self, path, body, timeout)
      text = jsonencode(body);
      if isempty(fieldnames(body)), text = '{}'; end
      answer = jsondecode(self.send('POST', path, text, timeout));
    end

    function answer = send(self, method, path, body, timeout)
      headers = {'Meissner-Client', self.client};
      if ~isempty(self.token), headers(end + 1, :) = {'Authorization', ['Bearer ' self.token]}; end
      if ~isempty(self.session_token), headers(end + 1, :) = {'Meissner-Session', self.session_token}; end
      if exist('OCTAVE_VERSION', 'builtin')
        headers(end + 1, :) = {'Content-Type', 'application/json'};
        answer = Meissner.by_curl(method, [self.url path], body, headers, timeout);
        return
      end
      asked = weboptions('ContentType', 'text', 'Timeout', ceil(timeout));
      asked.HeaderFields = headers;
      try
        if strcmp(method, 'GET')
          answer = webread([self.url path], asked);
        else
          asked.MediaType = 'application/json';
          answer = webwrite([self.url path], body, asked);
        end
      catch failure
        error('meissner:http', '%s %s%s: %s', method, self.url, path, failure.message);
      end
    end
  end

  methods (Static, Access = private)
    function asked = options(names, given)
      % Names and values as a struct.
      asked = struct();
      for place = 1:2:numel(given)
        if ~ischar(given{place}) || ~any(strcmp(given{place}, names)) || place == numel(given)
          error('meissner:bad_option', 'options are names and values; the names are: %s', strjoin(names, ', '));
        end
        asked.(given{place}) = given{place + 1};
      end
    end

    function body = with_texts(body, of)
      % Labels are texts.
      if nargin < 2, of = 'labels'; end
      if ~isfield(body, of), return, end
      for key = fieldnames(body.(of))'
        value = body.(of).(key{1});
        if ~ischar(value), body.(of).(key{1}) = num2str(value, 15); end
      end
    end

    function answer = by_curl(method, url, body, headers, timeout)
      % Octave alone. The request stands in a file that only this user may read, because of the tokens.
      quoted = @(text) ['"' strrep(strrep(strrep(text, '\', '\\'), '"', '\"'), sprintf('\n'), '\n') '"'];
      lines = {['url = ' quoted(url)], ['request = ' method], 'silent', 'show-error', ...
        sprintf('max-time = %d', ceil(timeout)), 'write-out = "\n%{http_code}"'};
      if ~isempty(body), lines{end + 1} = ['data-binary = ' quoted(body)]; end
      for row = 1:size(headers, 1)
        lines{end + 1} = ['header = ' quoted([headers{row, 1} ': ' headers{row, 2}])];
      end
      place = tempname();
      before = umask(77);
      file = fopen(place, 'w');
      umask(before);
      fprintf(file, '%s\n', lines{:});
      fclose(file);
      [failed, text] = system(['curl --config "' place '" 2>&1']);
      unlink(place);
      if failed ~= 0
        error('meissner:http', '%s %s: %s', method, url, strtrim(text));
      end
      [answer, code] = deal(text(1:end - 4), str2double(text(end - 2:end)));
      if code >= 400
        problem = jsondecode(answer);
        error(['meissner:' strrep(problem.code, '-', '_')], '%s', problem.detail);
      end
    end
  end
end
