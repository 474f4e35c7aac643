% Play an edge 1.5 s after a stimulus on the screen, with Psychtoolbox: all times are those of GetSecs.
% MEISSNER_URL is the daemon's address. In an experiment `shown` is what Screen('Flip', window) returns.
addpath(fullfile(fileparts(mfilename('fullpath')), '..'));
m = Meissner(getenv('MEISSNER_URL'), 'token', getenv('MEISSNER_TOKEN'), 'clock', @GetSecs);
m.arm('assume_rest', true, 'checked', 'example');
for trial = 1:2
  m.synchronise();
  shown = GetSecs();
  play = m.play('edge-45', 'seconds', 0.1, 'at', shown + 1.5, 'trial', trial, 'trigger', trial);
  receipt = m.wait(play);
  fprintf('trial %d: the edge began %.4f s after the flip, known to %.1f ms\n', ...
    trial, receipt.onset.time - shown, 1e3 * receipt.onset.uncertainty);
end
m.close();
